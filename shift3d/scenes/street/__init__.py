"""The procedural street: a spinning multi-beam LiDAR cast through a made-up town. Deterministic by seed."""
