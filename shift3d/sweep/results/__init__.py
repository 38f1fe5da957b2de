"""Results of a sweep: commits, final tables, and values computed from them."""
