"""Height maps seen from straight above, fused from the three cameras around the table."""
