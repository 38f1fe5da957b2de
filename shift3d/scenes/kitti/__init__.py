"""KITTI frames: file readers, scenes, and a writer."""
