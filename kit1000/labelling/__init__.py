"""Ground truth of real scenes: shapes that are known are registered to a depth image, and a person confirms them."""
