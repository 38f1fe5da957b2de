"""Detection metrics, breakdowns by group, confidence intervals and failure rules."""
