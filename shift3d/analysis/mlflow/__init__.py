"""MLflow: a mirror of what a sweep found, never the truth about it."""
