"""The image of a point: geometrical, scattered, composite; energies and the light outside (Eq. 26, 37, 44)."""
