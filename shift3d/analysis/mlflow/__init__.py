"""MLflow mirror of results; the folders on disk remain the source of truth."""
