"""Weather: fog, rain and snow along the light path, and wet ground."""
