"""Exact rays through surfaces of revolution: points by Newton's method, directions by Snell's law in vectors."""

from __future__ import annotations

import numpy as np


def sag(surface, r2):
    """z(r) and dz/d(r^2) of an optical surface at squared radii."""
    c, k = surface.curvature, 1.0 + surface.conic
    root = np.sqrt(1.0 - k * c**2 * r2)
    z, slope = c * r2 / (1.0 + root), c / (2.0 * root)
    for m, a in enumerate(surface.aspheric, start=2):
        z, slope = z + a * r2**m, slope + m * a * r2 ** (m - 1)
    return z, slope


def landed(prescription, position, direction):
    """Where rays [3, ray], given at the plane of the first vertex, meet the detector [2, ray]."""
    at, d = np.array(position, dtype=float), np.array(direction, dtype=float)
    d /= np.linalg.norm(d, axis=0)
    index, way = prescription.index_before, 1.0
    for surface in prescription.surfaces:
        t = -at[2] / d[2]
        for _ in range(30):
            p = at + t * d
            z, slope = sag(surface, p[0] ** 2 + p[1] ** 2)
            normal = np.array([-2.0 * slope * p[0], -2.0 * slope * p[1], np.ones_like(z)])
            t = t - (p[2] - z) / np.sum(normal * d, axis=0)
        at = at + t * d
        normal /= np.linalg.norm(normal, axis=0)
        cos = np.sum(normal * d, axis=0)
        if surface.is_mirror:
            d, way = d - 2.0 * cos * normal, -way
        else:
            ratio = index / surface.index
            bent = np.sign(cos) * np.sqrt(1.0 - ratio**2 * (1.0 - cos**2))
            d, index = ratio * d + (bent - ratio * cos) * normal, surface.index
        at[2] -= surface.thickness
    return (at + (way * prescription.image_shift - at[2]) / d[2] * d)[:2]
