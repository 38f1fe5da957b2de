"""Incremental inference: from frame to frame of one scene, only what changed and is needed is computed."""
