"""Follow-ups: processing of a finished sweep's solutions."""
