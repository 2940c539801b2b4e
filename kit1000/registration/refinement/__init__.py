"""The refinement of a candidate to a fit, by Levenberg-Marquardt steps."""
