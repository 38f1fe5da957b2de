"""Results as tables of text: what a command prints and a page shows."""
