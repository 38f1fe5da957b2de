"""Road vehicles: a procedural family of solid meshes, and the decoded vehicles that tasks insert."""
