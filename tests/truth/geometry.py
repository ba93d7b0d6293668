"""Third-order ray errors, counted rays, and closed forms of simple spots."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .system import TruthSystem


def wavefront(system: TruthSystem, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """W [mm] at pupil coordinates (x, y) of the unit pupil; also for complex arguments.

    W020 p + W040 p^2 + W131 p s + W222 s^2 + W220 H^2 p + W311 H^2 s, p = x^2 + y^2, s = H_x x + H_y y.
    """
    w = {k: system.seidel.get(k, 0.0) for k in ("W020", "W040", "W131", "W222", "W220", "W311")}
    hx, hy = system.field
    p, s, h2 = x * x + y * y, hx * x + hy * y, hx * hx + hy * hy
    fixed = w["W020"] * p + w["W040"] * p**2
    return fixed + w["W131"] * p * s + w["W222"] * s**2 + h2 * (w["W220"] * p + w["W311"] * s)


def ray_error(system: TruthSystem, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transverse ray errors (eps_x, eps_y) = -(1/u') grad W [mm] (Eq. 4), from the polynomial."""
    w = {k: system.seidel.get(k, 0.0) for k in ("W020", "W040", "W131", "W222", "W220", "W311")}
    hx, hy = system.field
    p, s, h2 = x * x + y * y, hx * x + hy * y, hx * hx + hy * hy
    radial = 2.0 * (w["W020"] + h2 * w["W220"]) + 4.0 * w["W040"] * p + 2.0 * w["W131"] * s
    along = w["W131"] * p + 2.0 * w["W222"] * s + h2 * w["W311"]
    return -(radial * x + along * hx) / system.image_slope, -(radial * y + along * hy) / system.image_slope


def ray_error_by_complex_step(system: TruthSystem, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same from the wavefront alone: dW/dx = Im W(x + i e, y)/e, exact to rounding as e -> 0."""
    e = 1e-30
    return (
        -wavefront(system, x + 1j * e, y).imag / e / system.image_slope,
        -wavefront(system, x, y + 1j * e).imag / e / system.image_slope,
    )


def pupil_rule(system: TruthSystem, rings: int, spokes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, y, weight) over the lit pupil, weights adding to 1: Gauss in rho times the trapezoid rule in azimuth.

    In a sector, where odd powers of rho do not cancel, the azimuth has a Gauss rule too.
    """
    t, w = np.polynomial.legendre.leggauss(rings)
    inner = system.obscuration
    rho = inner + (1.0 - inner) * 0.5 * (1.0 + t)
    if system.sector is None:
        phi, v = 2.0 * np.pi * (np.arange(spokes) + 0.5) / spokes, np.full(spokes, 1.0 / spokes)
    else:
        a, v = np.polynomial.legendre.leggauss(spokes)
        phi, v = system.sector[0] + (system.sector[1] - system.sector[0]) * 0.5 * (1.0 + a), 0.5 * v
    x, y = np.outer(rho, np.cos(phi)).ravel(), np.outer(rho, np.sin(phi)).ravel()
    return x, y, np.outer(w * rho / (1.0 + inner), v).ravel()


def spot_moments(system: TruthSystem) -> dict[str, float]:
    """Centroid, rms about it, and chief ray of the spot [mm]; the rule is exact for these polynomials."""
    x, y, w = pupil_rule(system, 8, 32)
    ex, ey = ray_error(system, x, y)
    cx, cy = float(w @ ex), float(w @ ey)
    chief = ray_error(system, 0.0, 0.0)
    return {
        "centroid_x": cx, "centroid_y": cy, "chief_x": float(chief[0]), "chief_y": float(chief[1]),
        "rms_x": math.sqrt(float(w @ (ex - cx) ** 2)), "rms_y": math.sqrt(float(w @ (ey - cy) ** 2)),
    }  # fmt: skip


def counted_pixels(system: TruthSystem, edges_x: np.ndarray, edges_y: np.ndarray, rays: int = 1001) -> np.ndarray:
    """Unscattered energy per pixel [y, x] of a uniform grid of edges [mm], by counting rays x rays pupil points.

    The paper's Appendix A: every lit ray carries the same light. Error about 2/rays of what crosses a pixel's edge.
    """
    u = (2.0 * np.arange(rays) + 1.0) / rays - 1.0
    x, y = (a.ravel() for a in np.meshgrid(u, u))
    rho = np.hypot(x, y)
    lit = (rho >= system.obscuration) & (rho <= 1.0)
    if system.sector is not None:
        first, last = system.sector
        lit &= np.mod(np.arctan2(y, x) - first, 2.0 * np.pi) <= last - first
    ex, ey = ray_error(system, x[lit], y[lit])
    nx, ny = len(edges_x) - 1, len(edges_y) - 1
    i = np.floor((ex - edges_x[0]) / (edges_x[-1] - edges_x[0]) * nx)
    j = np.floor((ey - edges_y[0]) / (edges_y[-1] - edges_y[0]) * ny)
    inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
    flat = (j[inside] * nx + i[inside]).astype(np.int64)
    return np.bincount(flat, minlength=nx * ny).reshape(ny, nx) / np.count_nonzero(lit)


def disc_in_rectangle(radius: float, x0: float, x1: float, y0: float, y1: float) -> float:
    """Area common to a disc about the origin and a rectangle, by the four corner areas."""

    def corner(x: float, y: float) -> float:  # area of the disc in [0, x] x [0, y], odd in both
        sign = math.copysign(1.0, x) * math.copysign(1.0, y)
        x, y = min(abs(x), radius), min(abs(y), radius)
        if x * x + y * y <= radius * radius:
            return sign * x * y
        a, b = math.sqrt(radius**2 - y * y), math.sqrt(radius**2 - x * x)  # the arc ends at (a, y), (x, b)
        return sign * 0.5 * (a * y + x * b + radius**2 * (math.atan2(y, a) - math.atan2(b, x)))

    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)


def defocused_annulus(outer: float, obscuration: float, x0: float, x1: float, y0: float, y1: float) -> float:
    """Energy of pure defocus: a uniform annulus of outer radius 2|W020|/u' [mm], in a rectangle. Exact."""
    window = x0, x1, y0, y1
    lit = disc_in_rectangle(outer, *window) - disc_in_rectangle(outer * obscuration, *window)
    return lit / (math.pi * outer**2 * (1.0 - obscuration**2))


def line_focus(half_length: float, obscuration: float, y0: float, y1: float) -> float:
    """Energy between y0 and y1 [mm] of an astigmatic line focus: the annulus seen edge on. Exact."""

    def below(y: float, r: float) -> float:  # area of the disc of radius r below y, over pi
        y = max(-r, min(r, y))
        return (y * math.sqrt(r * r - y * y) + r * r * (math.asin(y / r) + 0.5 * math.pi)) / math.pi if r > 0.0 else 0.0

    lit = [below(y, half_length) - below(y, half_length * obscuration) for y in (y0, y1)]
    return (lit[1] - lit[0]) / (half_length**2 * (1.0 - obscuration**2))


def coma_disc(image_slope: float, coma: float, radius: float) -> float:
    """Energy of pure coma W131 H = ``coma`` [mm], unobscured, within ``radius`` <= coma/u' [mm] of the chief ray.

    On the ring rho, eps = -(coma rho^2/u') (sin 2phi, 2 + cos 2phi), so |eps|^2 = (coma rho^2/u')^2 (5 + 4 cos 2phi):
    energy = mean over phi of radius u'/(coma sqrt(5 + 4 cos 2phi)), a complete elliptic integral:
    (2/pi) K(8/9)/3 radius u'/coma, parameter m = 8/9. Within that radius no ring is cut by the rim.
    """
    from scipy.special import ellipk

    return 2.0 / math.pi * float(ellipk(8.0 / 9.0)) / 3.0 * radius * image_slope / abs(coma)
