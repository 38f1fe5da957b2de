"""Training of the shape model and of the detectors; an interrupted training resumes to the same weights."""
