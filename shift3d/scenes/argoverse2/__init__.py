"""Argoverse 2 sensor data set: Feather files of a log, read with pyarrow alone."""
