"""One task: place a vehicle, attack it, score what was found."""
