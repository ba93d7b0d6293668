"""Exact rays at the surfaces of a prescription: where they meet one, its normal, mirror and refraction [mm].

A ray is a point and a unit direction, each an array (3, rays) in the frame of a surface's vertex, z along the light
that enters the telescope. A ray that misses becomes nan and stays it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from psfcli.telescope.prescription import OpticalSurface

Real = NDArray[np.float64]

_NEWTON_STEPS = 8  # each squares the error, which begins with the aspheric part of the sag


def to_plane(point: Real, direction: Real, z: float = 0.0) -> Real:
    """Where rays cross the plane at ``z`` [mm], shape (3, rays); infinite or nan for those along the plane."""
    return point + direction * ((z - point[2]) / direction[2])


def to_surface(surface: OpticalSurface, point: Real, direction: Real) -> Real:
    """Where rays meet a ``surface``, shape (3, rays): on its conic in closed form, on an asphere by Newton's method.

    The conic z = c r^2/[1 + sqrt(1 - (1 + K) c^2 r^2)] is met at t = F/[G +- sqrt(G^2 - c (1 + K n^2) F)] from the
    plane z = 0, with F = c (x^2 + y^2), G = n - c (l x + m y), (l, m, n) the direction and the sign that of n: the
    branch with the vertex. An asphere adds sum A_2i r^2i; valid where it departs little from its conic. Rays that miss
    the conic become nan.
    """
    start = to_plane(point, direction)
    c = surface.curvature
    F = c * (start[0] ** 2 + start[1] ** 2)
    G = direction[2] - c * (direction[0] * start[0] + direction[1] * start[1])
    with np.errstate(invalid="ignore"):
        root = np.sqrt(G**2 - c * (1.0 + surface.conic * direction[2] ** 2) * F)
    met: Real = start + direction * (F / (G + np.copysign(root, direction[2])))
    for _ in range(_NEWTON_STEPS if surface.aspheric else 0):
        sag, slope = _sag(surface, met)
        gap = met[2] - sag
        met = met - direction * (gap / (direction[2] - slope * (direction[0] * met[0] + direction[1] * met[1])))
    return met


def normal(surface: OpticalSurface, point: Real) -> Real:
    """Unit normals (dz/dx, dz/dy, -1)/length at points of a ``surface``, towards -z, shape (3, rays)."""
    _, slope = _sag(surface, point)
    gradient = np.stack([slope * point[0], slope * point[1], np.full(point.shape[1], -1.0)])
    return gradient / np.sqrt(np.sum(gradient**2, axis=0))


def _sag(surface: OpticalSurface, point: Real) -> tuple[Real, Real]:
    """The sag at the radius r of points, and its slope over r."""
    c, r2 = surface.curvature, point[0] ** 2 + point[1] ** 2
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (1.0 + surface.conic) * c**2 * r2)
    sag, slope = c * r2 / (1.0 + root), c / root
    for power, A in enumerate(surface.aspheric, start=2):
        sag = sag + A * r2**power
        slope = slope + 2.0 * power * A * r2 ** (power - 1)
    return sag, slope


def paraxial_matrix(surfaces: tuple[OpticalSurface, ...], index_before: float) -> Real:
    """What becomes of paraxial (y, dy/dz) from the first vertex to just behind the last, shape (2, 2).

    n'u' = n u - y c (n' - n) with indices negative where light travels towards -z.
    """
    matrix, index = np.eye(2), index_before
    for i, s in enumerate(surfaces):
        after = -index if s.is_mirror else math.copysign(s.index, index)
        matrix = np.array([[1.0, 0.0], [-s.curvature * (after - index) / after, index / after]]) @ matrix
        if i < len(surfaces) - 1:
            matrix = np.array([[1.0, s.thickness], [0.0, 1.0]]) @ matrix
        index = after
    return matrix
