"""The report of a sweep: one page that needs nothing but itself, one section a file."""
