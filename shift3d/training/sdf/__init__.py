"""Training of the shape model."""
