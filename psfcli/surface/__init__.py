"""Polished surfaces: spectra, autocovariances, generalised Harvey-Shack scatter (Eq. 28, 29)."""
