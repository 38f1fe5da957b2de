"""What stands on a procedural street, and where."""
