"""KITTI's frames: their files, the scenes read from them, and frames written like them."""
