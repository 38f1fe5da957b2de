"""Weather: fog, rain and snow on the way of the light, and what rain does to the ground."""
