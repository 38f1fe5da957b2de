"""Single solutions: chosen, rendered again, measured."""
