"""Solvers for first hits: the paper's, plain sphere tracing, linear regions, and the search that `standard` uses."""
