"""Evaluation of sweeps, detectors and suites: tables, figures, HTML pages and MLflow runs."""
