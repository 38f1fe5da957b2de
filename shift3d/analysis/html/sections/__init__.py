"""The sections of the report, those on one matter in one file."""
