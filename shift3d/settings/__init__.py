"""Settings: Hydra composes them, a typed schema checks them, plain functions turn them into objects."""
