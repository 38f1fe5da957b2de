"""Sweep service: planning, execution, commits, and final tables."""
