"""Commands that train, measure and compile detectors."""
