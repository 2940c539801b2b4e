"""What a method sees of a scene: inference alone, from one depth image to surfaces, masks and completed volumes."""
