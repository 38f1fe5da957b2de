"""Single solutions looked at again: chosen, rendered, measured."""
