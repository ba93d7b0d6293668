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
    seidel: SeidelTable, relative_field: tuple[float | Real, float | Real], azimuth: Real, image_slope: float
) -> tuple[Real, Real]:
    """The transverse ray error along pupil azimuths, as cubics in rho [mm] (Eq. 4).

    eps = -(1/u') dW/drho; along azimuth phi each component is a0 + a1 rho + a2 rho^2 + a3 rho^3. Returns the
    coefficients of x and of y, each of shape (4, *azimuth.shape); the components of ``relative_field`` are numbers, or
    arrays that broadcast with ``azimuth``. ``image_slope`` is u'.
    """
    Hx, Hy = relative_field
    H2 = Hx**2 + Hy**2
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    along = Hx * cos + Hy * sin
    defocus, astigmatism = 2.0 * (seidel.W020 + seidel.W220 * H2), 2.0 * seidel.W222 * along
    x, y = np.empty((2, 4, *along.shape))
    for fan, u, h in ((x, cos, Hx), (y, sin, Hy)):
        fan[0] = seidel.W311 * H2 * h
        fan[1] = defocus * u + astigmatism * h
        fan[2] = seidel.W131 * (2.0 * along * u + h)
        fan[3] = 4.0 * seidel.W040 * u
        fan /= -image_slope
    return x, y


def aberration_gradient(
    seidel: SeidelTable, relative_field: tuple[float, float], pupil_x: Real, pupil_y: Real, image_slope: float
) -> Real:
    """How the transverse ray error changes with the normalised field, d eps_a/d H_b [mm], shape (2, 2, *pupil_x.shape).

    Of Eq. 4 at points of the unit pupil: eps_a = -(1/u') dW/d rho_a, so that -u' d eps_a/d H_b =
    4 W220 rho_a H_b + 2 W131 rho_a rho_b + (W131 p + W311 H^2 + 2 W222 c) delta_ab + 2 W311 H_a H_b + 2 W222 H_a rho_b.
    """
    H, rho = np.asarray(relative_field), np.stack([pupil_x, pupil_y])
    along = np.tensordot(H, rho, 1)  # c = H . rho
    fields = H.reshape(2, *[1] * pupil_x.ndim)
    same = seidel.W131 * (rho**2).sum(axis=0) + seidel.W311 * (H @ H) + 2.0 * seidel.W222 * along
    slope = (
        4.0 * seidel.W220 * rho[:, None] * fields[None]
        + 2.0 * seidel.W131 * rho[:, None] * rho[None]
        + 2.0 * seidel.W311 * fields[:, None] * fields[None]
        + 2.0 * seidel.W222 * fields[:, None] * rho[None]
        + np.eye(2).reshape(2, 2, *[1] * pupil_x.ndim) * same
    )
    return -slope / image_slope
