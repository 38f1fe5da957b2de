"""Effects beyond the first hit, one file each; nothing here is imported unless a scene calls for it."""
