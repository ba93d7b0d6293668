"""The independent truth: rays deviated by chance, without any transform of a spectrum."""
