"""Construction of a procedural street: ground, objects and their placement."""
