"""First hits: the paper's algorithm, plain sphere tracing, linear regions, and the search that `standard` uses."""
