"""What accuracy costs in time: of a sweep, of the presets, of every setting of the frontier."""
