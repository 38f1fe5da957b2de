"""Folders in S3 and Google Cloud Storage, and readable messages for their errors."""
