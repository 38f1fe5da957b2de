"""Training recipes: each is one function that can stop, resume, and give the same weights again."""
