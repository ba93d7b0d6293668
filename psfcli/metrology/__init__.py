"""Measured spectra of a polished surface, and the K-correlation that fits them."""
