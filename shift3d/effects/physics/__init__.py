"""Physics that several effects share: materials, received power, silhouettes."""
