"""HTML report of a sweep: one self-contained page, with one module per section."""
