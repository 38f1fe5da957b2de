"""Procedural street: a spinning multi-beam LiDAR scans a made-up town. Deterministic by seed."""
