"""Single solutions, selected and rendered again for pages."""
