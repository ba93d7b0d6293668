"""The scattering function of one surface, in steradians."""

import numpy as np

from psfcli.surface.bsdf import bsdf
from psfcli.surface.harvey_shack import phase_variance
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface

WAVELENGTH = 9.4e-6


def test_the_scattering_function_has_the_values_of_the_direct_transform():
    # F/B^2 for C = 1.5, g = 0.8338169169 over all frequencies, to twelve digits by quadrature in mpmath
    bf = np.array([0.1, 1.0, 10.0, 100.0])
    F = np.array([0.0306620924717, 0.0138747311692, 1.60253759799e-4, 6.14242789214e-7])
    B, K2 = 1e7, (4.0 * np.pi / WAVELENGTH) ** 2  # so large a B that the horizon takes 3e-7 of g and no more
    mirror = Surface("m", 1.0, (KCorrelation(np.sqrt(0.8338169169 / K2), B, 1.5),))
    lost = 1.0 - phase_variance(mirror, WAVELENGTH) / 0.8338169169
    # exp(-g) grows by what g has lost to the horizon, a pure factor; 1e-9 is the function's own promise
    factor = np.exp(0.8338169169 * lost)
    found = bsdf(bf / B * WAVELENGTH, mirror, WAVELENGTH) * WAVELENGTH**2 / B**2 / factor
    np.testing.assert_allclose(found, F, rtol=1e-9)


def test_a_smooth_surface_scatters_nothing():
    assert not bsdf(np.array([1e-5, 1e-2]), Surface("m", 1.0), WAVELENGTH).any()
