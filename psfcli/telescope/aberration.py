"""Wavefront and transverse ray error of a Seidel table (Choi & Harvey 2012, Eq. 2 and 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from psfcli.telescope.seidel import SeidelTable

Real = NDArray[np.float64]


def wavefront(seidel: SeidelTable, relative_field: tuple[float, float], pupil_x: Real, pupil_y: Real) -> Real:
    """W [mm] at points of the unit pupil, same shape as ``pupil_x`` (Eq. 2 with the defocus of Table 1).

    W = W020 p + W040 p^2 + W131 p c + W222 c^2 + W220 H^2 p + W311 H^2 c, p = rho . rho, c = H . rho.
    """
    Hx, Hy = relative_field
    H2 = Hx**2 + Hy**2
    p = pupil_x**2 + pupil_y**2
    c = Hx * pupil_x + Hy * pupil_y
    return (
        (seidel.W020 + seidel.W220 * H2) * p
        + seidel.W040 * p**2
        + (seidel.W131 * p + seidel.W311 * H2) * c
        + seidel.W222 * c**2
    )


def transverse_aberration_along_azimuths(
    seidel: SeidelTable, relative_field: tuple[float, float], azimuth: Real, image_slope: float
) -> tuple[Real, Real]:
    """The transverse ray error along pupil azimuths, as cubics in rho [mm] (Eq. 4).

    eps = -(1/u') dW/drho; along azimuth phi each component is a0 + a1 rho + a2 rho^2 + a3 rho^3. Returns the
    coefficients of x and of y, each of shape (4, azimuths). ``image_slope`` is u'.
    """
    Hx, Hy = relative_field
    H2 = Hx**2 + Hy**2
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    along = Hx * cos + Hy * sin
    x, y = (
        np.stack(
            [
                np.full_like(azimuth, seidel.W311 * H2 * h),
                2.0 * (seidel.W020 + seidel.W220 * H2) * u + 2.0 * seidel.W222 * along * h,
                seidel.W131 * (2.0 * along * u + h),
                4.0 * seidel.W040 * u,
            ]
        )
        for u, h in ((cos, Hx), (sin, Hy))
    )
    return -x / image_slope, -y / image_slope
