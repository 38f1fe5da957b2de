"""Storage in folders and buckets: schemas, atomic writes, and the commit log."""
