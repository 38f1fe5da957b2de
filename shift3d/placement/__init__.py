"""Where a vehicle can stand in a scene: ground, constraints on a place, and sampling of places."""
