"""SE(3) poses, oriented boxes and their overlap."""
