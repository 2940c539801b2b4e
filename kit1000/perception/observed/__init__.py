"""What depth images show of parts and kits, in metres: points, plates, filled columns, height maps, volumes."""
