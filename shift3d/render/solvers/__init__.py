"""Solvers for first hits: the paper's algorithm, plain sphere tracing, linear regions, and the default search."""
