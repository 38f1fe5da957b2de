"""Execution of a plan's tasks: in this process or through Ray, with retries, quarantine and progress."""
