"""Vehicle detectors, differentiable from the score to the points."""
