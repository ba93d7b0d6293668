"""S(r) on contours, in doubles, and what the rounding leaves of it at each radius.

``unclipped`` takes, radius by radius, the best of

- rays at an angle, S = 4 Im Int q h(q) K0(-2 pi i q r) dq with h(0) subtracted or not: the core;
- the cut, S = -4 Int t K0(2 pi r t) Im h(it) dt: the wing, however faint, as nothing there cancels;
- the cut up to where the integrand is least, and a ray from there, which adds what is left of the core: between the
  two, where rays from the origin have lost their digits and the cut alone still misses the core;
- the sum of two parts, each on its own contour: the wing of narrow terms at the height of the plateau of much wider
  ones, which is beyond the digits of rays, and which the wide terms bar from the cut.

Trapezoids in the logarithm share their samples among all radii, which lie as far apart as those; the bent contour has
panels of its own at each radius. It and the parts are tried where the others are poor. ``clipped`` keeps the clip at
the horizon: the real axis to the last q_c, and a slanted ray from there; for where so much lies beyond the horizon that
the unclipped S is huge.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator

import numpy as np
from scipy.special import hankel1e, j0, kve

from .correlation import correlation_on_the_cut, correlation_parts
from .horizon import clip_frequencies
from .scatter import transfer_function
from .system import RoughSurface, Term, TruthSystem, specular_weight

STEP = 0.02  # in the logarithm of q; the rules converge like exp(-2 pi 0.15/step)
_LOW, _HIGH = -23.0, 5.5  # of ln(2 pi |q| r)
_BELOW = -16.0  # of ln(2 pi |q| times the widest knee): what is left out below is q^2 h(0) of about h(infinity)
_SLANTS = 0.12, 0.2, 0.3  # over pi
_ROUNDING = 4e-15  # of one sample, relative
_MOST_TURNS = 20.0  # h(it) oscillates like this argument, which the rule must resolve
_POOR = 2e-11  # noise of the others from which the bent contour is tried: rays are up to ten times as far off
_BENDS = np.geomspace(2.0, 100.0, 30)[:, None]  # of 2 pi r t: where the cut may be left
_PANEL, _MOST_PANELS = 2.0, 60  # the panels' width in 2 pi r |q|, or in the turns of h if those are faster
_BENT = np.exp(0.2j * np.pi)  # the direction it is left in
_NODE, _GAUSS = np.polynomial.legendre.leggauss(16)
_LAST = np.polynomial.legendre.legvander(_NODE, 15)[:, 14:]  # of a panel's polynomials: what they hold tells its error


def unclipped(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S [1/mm^2], relative noise) of the unclipped S at radii ``STEP`` apart in the logarithm."""
    return _best(*by_every_contour(system, log_r))


def by_every_contour(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same by each contour, shape [contour, radius]; infinite noise where one fails."""
    value, noise = _from_the_origin(system, log_r)
    for another in (_in_two_parts, _over_the_bend):
        poor = np.flatnonzero(noise.min(axis=0) > _POOR)
        more, more_noise = np.zeros(len(log_r)), np.full(len(log_r), np.inf)
        if poor.size:
            span = slice(poor[0], poor[-1] + 1)
            more[span], more_noise[span] = another(system, log_r[span])
        value, noise = np.vstack([value, more]), np.vstack([noise, more_noise])
    return value, noise


def _best(value: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of what has shape [contour, radius] the contour of least noise at each radius."""
    best = np.argmin(noise, axis=0)[None]
    return np.take_along_axis(value, best, 0)[0], np.take_along_axis(noise, best, 0)[0]


def _from_the_origin(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By the rays and by the cut."""
    x, size = _magnitudes(system, log_r)
    candidates = []
    for q, kernel in _rays(x, size):
        fallen, left = _exponents(system, q)
        subtracted = math.exp(_log_height(system)) * np.expm1(-fallen)
        for h in (subtracted, specular_weight(system) * np.expm1(left)):
            candidates.append(_sums(4.0 * STEP * (q * q * h), kernel))
    candidates.append(_on_the_cut(system, size, x, len(log_r)))
    value, noise = (np.array(part) for part in zip(*candidates, strict=True))
    noise = np.where(np.isfinite(noise) & (value > 0.0), noise / np.abs(value), np.inf)
    # where the core still shows, the cut misses it and does not know: what contradicts the rays is its error
    ray, ray_noise = _best(value[:-1], noise[:-1])
    apart = np.abs(value[-1] / ray - 1.0)
    noise[-1] = np.where(apart > 3.0 * ray_noise, np.maximum(noise[-1], apart), noise[-1])
    return value, noise


def _magnitudes(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """2 pi |q| r that every radius has samples at, and the |q| that all of them need together."""
    fall = math.fsum((s.K * t.sigma) ** 2 for s in system.surfaces for t in s.terms)  # of ln h from q = 0 outwards
    low = min(_LOW, _BELOW - 0.5 * fall + log_r[0] - math.log(max(_knees(system))))
    n = np.arange(math.floor(low / STEP), math.ceil(_HIGH / STEP) + 1)
    k = np.arange(n[0] - len(log_r) + 1, n[-1] + 1)
    return np.exp(n * STEP), np.exp(k * STEP - log_r[0]) / (2.0 * np.pi)


def _rays(x: np.ndarray, size: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(q, K0 at 2 pi |q| r = x) of each slant."""
    for slant in _SLANTS:
        turn = np.exp(1j * np.pi * slant)
        z = -1j * turn * x
        yield turn * size, kve(0, z) * np.exp(-z)


def _in_two_parts(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S [1/mm^2], relative noise) as a sum, each part on contours that suit it.

    With h = h1 h2, h2 of the widest knee, S is that of h1 exp(-g2), free of the wide terms, which would turn h(it) too
    fast for the cut, and that of h1 [h2 - exp(-g2)], all of which they scatter: rays lose nothing up to their knee.
    """
    narrow, wide = _widest_apart(system)
    if not narrow.surfaces:
        return np.zeros(len(log_r)), np.full(len(log_r), np.inf)
    once, once_noise = unclipped(narrow, log_r)
    once *= specular_weight(wide)
    x, size = _magnitudes(system, log_r)
    sums = []
    for q, kernel in _rays(x, size):
        h1 = np.exp(_log_height(narrow) - _exponents(narrow, q)[0])
        h2 = specular_weight(wide) * np.expm1(_exponents(wide, q)[1])
        sums.append(_sums(4.0 * STEP * (q * q * h1 * h2), kernel))
    halo, halo_noise = _best(*(np.array(part) for part in zip(*sums, strict=True)))
    total = once + halo
    noise = (once * once_noise + halo_noise) / total
    return total, np.where(np.isfinite(noise) & (total > 0.0), noise, np.inf)


def _widest_apart(system: TruthSystem) -> tuple[TruthSystem, TruthSystem]:
    """``system`` without the terms of the widest knee, and those alone."""
    widest = max(_knees(system))
    narrow, wide = (
        TruthSystem(
            system.wavelength,
            tuple(
                s._replace(terms=tuple(t for t in s.terms if chosen(_knee(system, s, t), widest)))
                for s in system.surfaces
            ),
        )
        for chosen in (operator.lt, operator.eq)
    )
    return narrow, wide


def _sums(samples: np.ndarray, kernel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Im Sum samples x kernel at every radius, and its noise: the rounding, and what lies below the first sample."""
    size = np.convolve(np.abs(samples), np.abs(kernel[::-1]), "valid")[::-1]
    radii = len(samples) - len(kernel) + 1
    below = np.abs(kernel[0] * samples[:radii])[::-1] / (2.0 * STEP)  # they fall at least like q^2
    return np.convolve(samples, kernel[::-1], "valid")[::-1].imag, _ROUNDING * size + below


def _on_the_cut(system: TruthSystem, t: np.ndarray, x: np.ndarray, radii: int) -> tuple[np.ndarray, np.ndarray]:
    """S from Im h(it), and its noise: the rounding, and the smallest sample beyond the peak, where the sum must end."""
    resolved = 2.0 * np.pi * max(_knees(system)) * t < _MOST_TURNS
    real, imaginary = _exponent_on_the_cut(system, t)
    samples = -4.0 * STEP * t * t * np.exp(_log_height(system) + real) * np.sin(imaginary)
    # h(it) swings between huge and tiny: the envelope of what has been is no accident
    envelope = np.minimum(np.maximum.accumulate(np.abs(imaginary)), 1.0)
    bound = 4.0 * STEP * t * t * np.exp(_log_height(system) + np.maximum.accumulate(np.abs(real))) * envelope
    bound[~resolved] = np.inf
    kernel = kve(0, x) * np.exp(-x)
    shifted, bounds = (np.lib.stride_tricks.sliding_window_view(v, len(kernel))[::-1] for v in (samples, bound))
    value, noise = np.empty(radii), np.empty(radii)
    peak = int(np.searchsorted(x, 1.0))
    for m in range(radii):
        size = bounds[m] * kernel
        finite = np.isfinite(size[peak:])
        end = peak + int(np.argmin(np.where(finite, size[peak:], np.inf)))
        value[m] = np.sum(shifted[m, :end] * kernel[:end])
        noise[m] = _ROUNDING * np.sum(size[:end]) + 100.0 * size[end]
    return value, noise


def _over_the_bend(system: TruthSystem, log_r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S [1/mm^2], relative noise) by the bent contour, at each radius on its own."""
    value, noise = zip(*(_bent(system, math.exp(t)) for t in log_r), strict=True)
    return np.array(value), np.array(noise)


def _bent(system: TruthSystem, r: float) -> tuple[float, float]:
    """(S [1/mm^2], relative noise and error) by the cut from q = 0 to the bend, and the ray from there.

    On the cut nothing cancels, and what the ray adds is as small as the integrand is near the saddle that the core
    comes from. Both integrands may have any constant subtracted from h, h(0) here.
    """
    # h turns once as 2 pi r |q| grows by this, however faint the term of the widest knee
    turn = min(1.0, r / max(_knees(system)))
    if (most := _MOST_PANELS * _PANEL * turn) < _BENDS[0]:
        return 0.0, math.inf
    bend = _bend(system, r, most)
    z, weight = _panels([*np.exp(np.arange(_LOW, math.log(turn))), *np.arange(turn, bend, _PANEL * turn), bend])
    real, imaginary = _exponent_on_the_cut(system, z / (2.0 * np.pi * r))
    up = -z * kve(0, z) * np.exp(_log_height(system) + real - z) * np.sin(imaginary)
    last = 45.0 / _BENT.imag
    graded = turn * np.expm1(0.4 * np.arange(1.0 + math.log1p(2.0 * _PANEL / turn) / 0.4))
    along, along_weight = _panels([*graded, *np.arange(graded[-1] + _PANEL, last, _PANEL), last])
    z = 1j * bend + _BENT * along
    h = math.exp(_log_height(system)) * np.expm1(-_exponents(system, z / (2.0 * np.pi * r))[0])
    away = _BENT * z * kve(0, -1j * z) * np.exp(1j * z) * h
    # per panel: what the last Legendre coefficients hold is as much as the rule may have missed
    up, away = (w * samples.reshape(-1, len(_NODE)) for samples, w in ((up, weight), (away, along_weight)))
    total = float(up.sum() + away.imag.sum())
    noise = sum(_ROUNDING * np.abs(part).sum() + np.abs(part @ _LAST).sum() for part in (up, away))
    if not (math.isfinite(noise) and total > 0.0):
        return 0.0, math.inf
    return total / (np.pi * r) ** 2, float(noise) / total


def _bend(system: TruthSystem, r: float, most: float) -> float:
    """The 2 pi r t, up to ``most``, that keeps the highest point of the way lowest.

    Far out that is beyond all that counts; nearer, the saddle, or before it where it lies off the cut.
    """
    real, imaginary = _exponent_on_the_cut(system, _BENDS / (2.0 * np.pi * r))
    up = np.maximum(real, 0.0) + np.log(np.minimum(np.abs(imaginary), 1.0)) + 2.0 * np.log(_BENDS) - _BENDS
    z = 1j * _BENDS + _BENT * np.append(0.0, np.geomspace(0.1, 50.0, 30))
    fallen = _exponents(system, z / (2.0 * np.pi * r))[0]
    away = np.maximum(-fallen.real, 0.0) + np.log(np.minimum(np.abs(fallen), 1.0)) + 2.0 * np.log(np.abs(z)) - z.imag
    highest = np.logaddexp(np.maximum.accumulate(up)[:, 0], away.max(axis=1))
    return float(_BENDS[np.argmin(np.where(_BENDS[:, 0] <= most, highest, np.inf)), 0])


def _panels(edges: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of Gauss panels between the edges, in one row, and their weights, shape [panel, node]."""
    half = 0.5 * np.diff(edges)[:, None]
    return (np.array(edges)[:-1, None] + half * (1.0 + _NODE)).ravel(), half * _GAUSS


def clipped(system: TruthSystem, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(S [1/mm^2], relative noise) with the clip at any radii [mm]."""
    clips = sorted(clip_frequencies(system.wavelength, system.surfaces))
    first = min(clips[0], clips[-1] / 24.0)
    edges = np.unique([*clips, *np.linspace(first, clips[-1], 41), *(first * 0.5 ** np.arange(1, 40)), 0.0])
    x, w = np.polynomial.legendre.leggauss(14)
    half = 0.5 * np.diff(edges)[:, None]
    q, weight = (edges[:-1, None] + half + half * x).ravel(), (half * w).ravel()
    near = 2.0 * np.pi * q * weight * (transfer_function(system, q) - specular_weight(system))
    J = j0(2.0 * np.pi * np.outer(r, q))
    value, noise = J @ near, np.abs(J) @ np.abs(near)
    turn, step = np.exp(0.2j * np.pi), 2.0 * STEP
    distance = np.exp(np.arange(-52.0, math.log(45.0 / turn.imag), step))  # 2 pi r |q - last clip|
    for i, radius in enumerate(r):
        along = turn * distance / (2.0 * np.pi * radius)
        q_far = clips[-1] + along
        fallen, left = _exponents(system, q_far)
        high = left.real > 1.0
        h = specular_weight(system) * np.expm1(np.where(high, 0.0, left))
        h[high] = np.exp(_log_height(system) - fallen[high]) - specular_weight(system)
        z = 2.0 * np.pi * radius * q_far
        far = 2.0 * np.pi * step * q_far * h * hankel1e(0, z) * np.exp(1j * z) * along
        value[i] += far.sum().real
        noise[i] += np.abs(far).sum()
    return value, _ROUNDING * noise / np.abs(value)


def _exponents(system: TruthSystem, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums over all terms of K^2 sigma^2 (1 - rho) and of K^2 sigma^2 rho at complex q."""
    fallen, left = np.zeros_like(q), np.zeros_like(q)
    for s in system.surfaces:
        for t in s.terms:
            parts = correlation_parts(2.0 * np.pi * system.wavelength * s.d * q / t.B, 0.5 * (t.C - 1.0))
            fallen += (s.K * t.sigma) ** 2 * parts[0]
            left += (s.K * t.sigma) ** 2 * parts[1]
    return fallen, left


def _exponent_on_the_cut(system: TruthSystem, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real and imaginary part of ln [h(it)/h(0)], h with the unscattered light."""
    real, imaginary = np.zeros_like(t), np.zeros_like(t)
    for s in system.surfaces:
        for term in s.terms:
            x, nu = 2.0 * np.pi * system.wavelength * s.d * t / term.B, 0.5 * (term.C - 1.0)
            fallen, part = correlation_on_the_cut(x, nu)
            real -= (s.K * term.sigma) ** 2 * fallen
            imaginary += (s.K * term.sigma) ** 2 * part
    return real, imaginary


def _knee(system: TruthSystem, surface: RoughSurface, term: Term) -> float:
    return float(system.wavelength * surface.d / term.B)


def _knees(system: TruthSystem) -> set[float]:
    return {_knee(system, s, t) for s in system.surfaces for t in s.terms}


def _log_height(system: TruthSystem) -> float:
    """Sum of K^2 C(0) - g, the logarithm of the unclipped OTF at q = 0."""
    return math.fsum(
        (s.K * t.sigma) ** 2 * beyond
        for s in system.surfaces
        for t, beyond in zip(s.terms, s.beyond(system.wavelength), strict=True)
    )
