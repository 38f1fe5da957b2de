"""How the tasks of a plan run: in this process or through Ray, with retries, quarantine and progress."""
