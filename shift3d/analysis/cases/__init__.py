"""Single solutions: chosen, rendered again."""
