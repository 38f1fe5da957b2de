"""Field of a vehicle for the solvers: metric field, SDF grid, verified bounding box, linearization."""
