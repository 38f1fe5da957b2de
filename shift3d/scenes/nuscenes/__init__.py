"""nuScenes: JSON tables and LiDAR files of a release, read without its development kit."""
