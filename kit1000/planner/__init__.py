"""A simulated robot that carries out predicted motions: a UR5e with a suction cup picks parts and inserts them."""
