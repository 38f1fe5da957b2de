"""The sweep service: plan, run, commit, and the final tables."""
