"""Settings: composed by Hydra, checked by a typed schema, turned into objects by plain functions."""
