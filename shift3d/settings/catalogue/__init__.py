"""What settings refer to: scenes, vehicles and detectors, with the hashes of their content."""
