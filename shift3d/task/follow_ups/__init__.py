"""What is done with a finished sweep's solutions."""
