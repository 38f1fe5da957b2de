"""What is kept on disk: schemas, atomic writes, and the commit log."""
