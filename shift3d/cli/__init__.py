"""Command line: argument parsing and wiring, nothing else."""
