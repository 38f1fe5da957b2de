"""Training of detectors: recipes, crops, targets, losses, the loop, and detection over scene sets."""
