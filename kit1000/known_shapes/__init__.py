"""Poses of shapes whose meshes are known, in a depth image: analysis by synthesis of the disparity image."""
