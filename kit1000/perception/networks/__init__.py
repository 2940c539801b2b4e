"""What the networks of perception share: weight files, their loading, the U-Net."""
