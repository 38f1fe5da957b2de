"""One task: place a vehicle, attack it, and score the solution."""
