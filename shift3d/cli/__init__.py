"""The command line: argument parsing and wiring, nothing else."""
