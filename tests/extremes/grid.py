"""The arguments, region by region, and the tables of what ``exact`` gives for them."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

from mpmath import mpf, nstr

from . import exact

COLUMNS = {
    "autocovariance": (("u", "nu"), ("rho", "complement")),
    "transfer": (("sigma", "B", "C", "wavelength", "r"), ("sigma_rel", "tis", "transfer")),
    "bsdf": (("beta", "sigma", "B", "C", "wavelength"), ("bsdf",)),
}
EXACT: dict[str, Callable[..., Sequence[mpf]]] = {
    "autocovariance": exact.both_parts,
    "transfer": exact.transfer,
    "bsdf": lambda *arguments: [exact.bsdf(*arguments)],
}
SMALLEST = 2.0**-1022  # of the normal doubles

Row = dict[str, float | str]


def path(table: str) -> Path:
    """Where a table lies."""
    return Path(__file__).with_name(f"{table}.csv")


def rows(table: str) -> list[Row]:
    """A table, from disk."""
    with path(table).open(newline="") as file:
        return [{k: v if k == "region" else float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def values(table: str, arguments: Sequence[float]) -> list[str]:
    """The exact values as the table has them: 18 digits, and 0 below the normal doubles."""
    return [nstr(v, 18) if v >= SMALLEST else "0" for v in EXACT[table](*arguments)]


def draw(table: str) -> list[tuple[str, tuple[float, ...]]]:
    """The region and the arguments of every row of a table; always the same ones."""
    random = Random(table)
    return [(name, region(random)) for name, count, region in REGIONS[table] for _ in range(count)]


def _log(random: Random, low: float, high: float) -> float:
    """A number of six digits, uniform in the logarithm."""
    return float(f"{math.exp(random.uniform(math.log(low), math.log(high))):.6g}")


# -- rho and 1 - rho: (u, nu)


def _tiny_distances(random: Random) -> tuple[float, float]:
    return _log(random, 1e-300, 1e-3), _log(random, 1e-6, 1000.0)


def _whole_orders(random: Random) -> tuple[float, float]:
    nu = random.randint(1, 30) + random.choice([0.0, 1e-15, -1e-13, 1e-9, -1e-6, 1e-3])
    return _log(random, 1e-20, 1e3), nu


def _half_odd_orders(random: Random) -> tuple[float, float]:
    return _log(random, 1e-12, 700.0), random.choice([0.5, 1.5, 2.5]) + random.choice([0.0, 5e-10, -5e-10])


def _flat_spectra(random: Random) -> tuple[float, float]:
    return _log(random, 1e-300, 700.0), _log(random, 1e-6, 0.1)


def _steep_spectra(random: Random) -> tuple[float, float]:
    nu = _log(random, 25.0, 1000.0)
    return _log(random, 1e-8 * nu**0.5, 10.0 * nu**0.5), nu


def _knee(random: Random) -> tuple[float, float]:
    nu = _log(random, 0.05, 60.0)
    return _log(random, 0.3 * nu**0.5, 5.0 * nu**0.5), nu


def _tail(random: Random) -> tuple[float, float]:
    nu = _log(random, 1e-6, 1000.0)
    return _log(random, 5.0 + 3.0 * nu**0.5, 690.0 + 1.6 * nu), nu


def _outside_the_doubles(random: Random) -> tuple[float, float]:
    large = random.random() < 0.5
    u = _log(random, 4000.0, 1e300) if large else random.choice([0.0, _log(random, 1e-300, 1e-160)])
    return u, _log(random, 1e-6 if large else 1.2, 1000.0)


# -- sigma_rel, TIS and H: (sigma, B, C, wavelength, r)


def _mirror(random: Random, g: float, C: float, length: float | None = None) -> tuple[float, float, float, float]:
    """A mirror of phase variance about ``g``, with its knee at ``length`` wavelengths if that is given."""
    wavelength = _log(random, 1e-7, 1.0)
    B = float(f"{wavelength * length:.6g}") if length else _log(random, 1e-6, 1e6)
    share = -math.expm1(0.5 * (1.0 - C) * math.log1p((B / wavelength) ** 2))
    return float(f"{wavelength * math.sqrt(g / share) / (4.0 * math.pi):.6g}"), B, C, wavelength


def _separation(random: Random, mirror: tuple[float, float, float, float], exponent: float) -> tuple[float, ...]:
    """The mirror and a separation at which about ``exponent`` stands in H, by the first term of 1 - rho."""
    sigma, B, C, wavelength = mirror
    nu, ratio = 0.5 * (C - 1.0), exponent * (wavelength / (4.0 * math.pi * sigma)) ** 2
    half = ratio ** (0.5 / nu) if nu < 0.9 else (ratio * abs(nu - 1.0) + 1e-3 * ratio) ** 0.5
    u = min(max(2.0 * half, 1e-280), 3.0 * math.sqrt(2.0 * nu) + 700.0 * random.random() ** 8)
    return *mirror, float(f"{u * B / (2.0 * math.pi):.6g}")


def _smooth(random: Random) -> tuple[float, ...]:
    mirror = _mirror(random, _log(random, 1e-300, 1e-10), 1.0 + _log(random, 2e-6, 2000.0))
    return *mirror, _log(random, 1e-12 * mirror[1], 100.0 * mirror[1])


def _ordinary(random: Random) -> tuple[float, ...]:
    mirror = _mirror(random, _log(random, 1e-8, 10.0), random.uniform(1.05, 8.0), _log(random, 10.0, 1e6))
    return *mirror, _log(random, 1e-8 * mirror[1], 10.0 * mirror[1])


def _rough(random: Random) -> tuple[float, ...]:
    mirror = _mirror(random, _log(random, 10.0, 1e6), random.uniform(1.2, 12.0), _log(random, 1e3, 1e8))
    return _separation(random, mirror, _log(random, 1e-3, 2000.0))


def _flat(random: Random) -> tuple[float, ...]:
    mirror = _mirror(random, _log(random, 1e-3, 300.0), 1.0 + _log(random, 2e-6, 0.2), _log(random, 1.0, 1e8))
    return *mirror, _log(random, 1e-3 * mirror[3], 10.0 * mirror[1])


def _steep(random: Random) -> tuple[float, ...]:
    mirror = _mirror(random, _log(random, 1e-3, 1e5), _log(random, 12.0, 2000.0), _log(random, 10.0, 1e8))
    return _separation(random, mirror, _log(random, 1e-3, 700.0))


def _clip(random: Random) -> tuple[float, ...]:
    mirror = _mirror(random, _log(random, 1e-3, 900.0), random.uniform(1.02, 3.0), _log(random, 0.1, 30.0))
    return *mirror, _log(random, 1e-3 * mirror[3], 3.0 * mirror[3])


# -- BSDF: (beta, sigma, B, C, wavelength)


def _scatterer(random: Random, g: float, C: float, b: float) -> tuple[float, ...]:
    sigma, B, C, wavelength = _mirror(random, g, C, _log(random, 1e4, 1e7))
    return float(f"{b * wavelength / B:.6g}"), sigma, B, C, wavelength


def _any_slope(random: Random) -> tuple[float, ...]:
    C = float(f"{random.uniform(1.05, 8.0):.4g}")
    return _scatterer(random, _log(random, 1e-12, 3.0), C, _log(random, 0.01, 10.0 ** (15.0 / (C + 1.0))))


def _closed_form(random: Random) -> tuple[float, ...]:
    C, roughest = random.choice([(2.0, 900.0), (4.0, 40.0), (6.0, 10.0), (8.0, 1.0)])
    g = _log(random, 1e-14, roughest)
    return _scatterer(random, g, C, _log(random, 1e-3, 10.0 ** (20.0 / (C + 1.0))))


REGIONS: dict[str, tuple[tuple[str, int, Callable[[Random], tuple[float, ...]]], ...]] = {
    "autocovariance": (
        ("tiny distances", 400, _tiny_distances),
        ("whole orders", 400, _whole_orders),
        ("half-odd orders", 200, _half_odd_orders),
        ("flat spectra", 300, _flat_spectra),
        ("steep spectra", 300, _steep_spectra),
        ("knee", 300, _knee),
        ("tail", 400, _tail),
        ("outside the doubles", 200, _outside_the_doubles),
    ),
    "transfer": (
        ("smooth", 150, _smooth),
        ("ordinary", 150, _ordinary),
        ("rough", 250, _rough),
        ("flat", 150, _flat),
        ("steep", 200, _steep),
        ("clip", 100, _clip),
    ),
    "bsdf": (("any slope", 120, _any_slope), ("closed form", 80, _closed_form)),
}


def make(table: str, parallel_map: Callable[..., list[list[str]]]) -> None:
    """Compute a table and write it."""
    drawn = draw(table)
    names, results = COLUMNS[table]
    computed = parallel_map(values, [table] * len(drawn), [arguments for _, arguments in drawn])
    with path(table).open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["region", *names, *results])
        for (region, arguments), result in zip(drawn, computed, strict=True):
            writer.writerow([region, *map(repr, arguments), *result])
