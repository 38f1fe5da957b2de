"""What accuracy costs in time: every setting's errors against the reference, and its milliseconds beside them."""
