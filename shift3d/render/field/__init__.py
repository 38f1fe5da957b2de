"""What solvers ask of a vehicle: its field in metres, a grid of it, its box, and its linearization."""
