"""Physics shared by several effects: materials, received power, silhouettes."""
