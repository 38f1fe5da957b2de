"""Networks, anchor heads and centre heads, box coding, weights."""
