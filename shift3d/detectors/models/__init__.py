"""Networks, what they predict against (anchors, centres), box coding, weights."""
