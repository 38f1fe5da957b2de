"""Waymo Open Dataset, version 2: Parquet components of a segment, read with pyarrow alone."""
