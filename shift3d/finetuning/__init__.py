"""Fine-tuning on the objects that a sweep found, and whether the detector is the better for it."""
