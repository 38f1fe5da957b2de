"""Folders in S3 and GCS, and what their errors say to a reader."""
