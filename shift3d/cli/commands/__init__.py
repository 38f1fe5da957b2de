"""Subcommands of ``shift3d``, one per file."""
