"""Fine-tuning of a detector on the objects that a sweep found, and measurement of its gain."""
