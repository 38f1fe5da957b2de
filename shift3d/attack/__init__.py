"""Following a detector's gradient to a shape or a pose that it misses."""
