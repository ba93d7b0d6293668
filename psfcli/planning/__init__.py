"""What a scene requires, decided before anything is computed."""
