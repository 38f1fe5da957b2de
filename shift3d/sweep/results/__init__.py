"""What a sweep leaves: commits, the final tables, and what is computed from them."""
