"""Parts: families of procedural machine parts, drawn in millimetres, and meshes read from files."""
