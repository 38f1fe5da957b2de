"""Commands on a finished sweep's solutions."""
