"""The surface functions at the ends of their ranges: a table of exact values, and limits reached continuously.

``filterwarnings = error`` makes every numpy warning a failure.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from random import Random

import mpmath
import numpy as np
import pytest
from extremes import exact, grid, judge
from scipy import special

from psfcli.surface.autocovariance import autocovariance, both_parts, decorrelation
from psfcli.surface.bsdf import bsdf
from psfcli.surface.harvey_shack import (
    phase_variance,
    relative_rms,
    surface_transfer_function,
    total_integrated_scatter,
    transfer_exponent,
)
from psfcli.surface.mixture import MixtureError
from psfcli.surface.psd import KCorrelation

ROOT = Path(__file__).resolve().parent.parent
WAVELENGTH = 1e-5
K = 4.0 * math.pi / WAVELENGTH


@pytest.mark.parametrize("table", grid.COLUMNS)
def test_every_exact_value_is_met(table):
    rows = grid.rows(table)
    units = judge.errors(judge.evaluate(judge.PSFCLI[table], table, rows), table, rows)
    for name, excess in units.items():
        far = int(excess.argmax())
        assert excess[far] <= 1.0, f"{name}: {excess[far]:.3g} times the allowed error at {rows[far]}"


def test_the_tables_hold_the_drawn_arguments_and_reach_to_the_ends():
    values = 0
    for table, (names, results) in grid.COLUMNS.items():
        rows = grid.rows(table)
        assert [(row["region"], tuple(row[name] for name in names)) for row in rows] == grid.draw(table)
        values += len(rows) * len(results)
    assert values >= 5000
    assert len(grid.rows("bsdf")) >= 200
    assert sum(grid.path(table).stat().st_size for table in grid.COLUMNS) < 400_000
    nu, u = (judge.column(grid.rows("autocovariance"), name) for name in ("nu", "u"))
    assert nu.min() < 1e-5
    assert nu.max() > 900.0
    assert u.min() == 0.0
    assert u.max() > 1e295


@pytest.mark.parametrize(("table", "count", "digits"), [("autocovariance", 60, 1e-15), ("transfer", 36, 1e-15)])
def test_the_stored_values_can_be_made_again(table, count, digits):
    chosen = Random(f"again {table}").sample(grid.rows(table), count)
    names, results = grid.COLUMNS[table]
    for row in chosen:
        again = [float(v) for v in grid.values(table, [row[name] for name in names])]
        assert again == pytest.approx([row[name] for name in results], rel=digits, abs=0.0)  # a double's rounding


def test_stored_bsdfs_can_be_made_again():
    closed = [row for row in grid.rows("bsdf") if row["region"] == "closed form" and row["C"] < 6.0]
    gentle = [row for row in grid.rows("bsdf") if row["region"] == "any slope" and row["C"] < 3.0]
    for row in Random("again").sample(closed, 3) + Random("again").sample(gentle, 1):
        (again,) = grid.values("bsdf", [row[name] for name in grid.COLUMNS["bsdf"][0]])
        assert float(again) == pytest.approx(row["bsdf"], rel=1e-12)  # the digits the contour is asked for


@pytest.mark.parametrize("nu", [1e-6, 0.3, 1.0, 2.0 + 1e-13, 7.5, 400.0])
def test_the_exact_values_agree_between_three_definitions(nu):
    with mpmath.workdps(110):
        u, order = mpmath.mpf(1.7), mpmath.mpf(nu)
        series, integral = exact._by_series(u, order), 1 - exact._by_integral(u, order)
        bessel = 1 - 2 ** (1 - order) / mpmath.gamma(order) * u**order * mpmath.besselk(order, u)
        assert abs(series / integral - 1) < mpmath.mpf(10) ** -35  # 40 digits each, less those of 1 - rho
        assert abs(series / bessel - 1) < mpmath.mpf(10) ** -35


def test_exact_bsdfs_agree_between_the_series_and_the_contour():
    sigma = math.sqrt(0.83) / K
    for C in (4.0, 8.0):
        by_contour = exact.scatter_psf_mpmath(exact.mirror(sigma, 1.0, C, WAVELENGTH), 3.0 * WAVELENGTH)
        by_series = exact.bsdf(3.0 * WAVELENGTH, sigma, 1.0, C, WAVELENGTH)
        assert float(by_contour / by_series) == pytest.approx(1.0, rel=1e-12)  # the contour's digits


def test_the_judge_lets_no_nan_and_no_false_zero_pass():
    found = np.array([np.nan, np.inf, 0.0, -1.0, 1.0, 0.0, 1e-300])
    values = np.array([1.0, 1.0, 1e-300, 1.0, 1.0, 0.0, 0.0])
    passed = judge.excess(found, values, np.full(7, 1e-12)) <= 1.0
    assert passed.tolist() == [False, False, False, False, True, True, False]


# -- limits of the autocovariance


def test_the_ends_of_the_axis_are_exact():
    for nu in (1e-6, 0.5, 1.0, 3.7, 30.0, 1000.0):
        rho, complement = both_parts(np.array([0.0, 5e-324, 1e6, 1e300, np.inf]), nu)
        assert rho[[0, 2, 3, 4]].tolist() == [1.0, 0.0, 0.0, 0.0]
        assert complement[[0, 2, 3, 4]].tolist() == [0.0, 1.0, 1.0, 1.0]
        assert 0.0 < rho[1] <= 1.0
    assert both_parts(np.array(0.5), 0.5)[0] == pytest.approx(math.exp(-0.5), rel=1e-15)
    assert autocovariance(np.empty(0), 1.0).size == 0


def test_closed_forms_and_their_neighbours():
    u = np.geomspace(1e-10, 600.0, 400)
    closed = {
        2: np.exp(-u),
        3: u * special.k1e(u) * np.exp(-u),
        4: (1 + u) * np.exp(-u),
        6: (1 + u + u * u / 3) * np.exp(-u),
    }
    for C, rho in closed.items():
        # rounding in exp(-u), u up to 600
        np.testing.assert_allclose(autocovariance(u, 0.5 * (C - 1.0)), rho, rtol=3e-13)
    np.testing.assert_allclose(decorrelation(u, 0.5), -np.expm1(-u), rtol=1e-14)
    for C in (2.0, 3.0, 4.0, 5.0, 6.0, 7.0):
        below, at, above = (both_parts(u, 0.5 * (C + shift - 1.0)) for shift in (-1e-9, 0.0, 1e-9))
        for left, middle, right in zip(below, at, above, strict=True):
            # linear over 1e-9: the curvature is (ln u)^2 1e-18, the rest rounding in u^(2 nu)
            np.testing.assert_allclose(0.5 * (left + right), middle, rtol=3e-13)
        assert np.all(above[0][u > 1.0] > below[0][u > 1.0])  # and it does change: rho grows with C at fixed u


@pytest.mark.parametrize("nu", [1e-6, 0.01, 0.5, 1.0, 2.2, 11.0, 23.4, 23.6, 24.9, 25.1, 60.0, 1000.0])
def test_series_and_bessel_function_join(nu):
    u = math.sqrt(2.0 * nu)
    (below, above), (less, more) = both_parts(np.array([u * (1 - 1e-13), u * (1 + 1e-13)]), nu)
    tolerance = max(1.0, nu / 100.0) * 1e-12 + 4e-13  # the promise, and the change over the step
    assert above == pytest.approx(below, rel=tolerance)
    assert more == pytest.approx(less, rel=tolerance)


def test_C_to_1_is_a_logarithm():
    u = np.array([1e-200, 1e-3, 1.0, 30.0])
    for nu in (1e-6, 1e-8, 1e-10):
        # rho/(2 nu) = K_0(u) [1 + O(nu ln u)]
        np.testing.assert_allclose(autocovariance(u, nu) / (2.0 * nu), special.k0(u), rtol=500.0 * nu)
        # C - 1 = 2 nu is told to 1e-16/nu by a double
        term = KCorrelation(1.0, 1.0, 1.0 + 2.0 * nu)
        share = term.band_share(3.0, 700.0) / (0.5 * (term.C - 1.0))
        assert share == pytest.approx(math.log((1.0 + 700.0**2) / 10.0), rel=10.0 * nu)


def test_C_to_infinity_is_a_gaussian():
    x = np.array([1e-6, 0.03, 0.5, 1.5, 5.0])  # u^2/(4 nu)
    for nu in (250.0, 500.0, 1000.0):
        rho, complement = both_parts(np.sqrt(4.0 * nu * x), nu)
        # the mean of exp(-nu x/t) over t ~ Gamma(nu), to first order in 1/nu; the second is below 12 x/nu^2
        first = np.exp(-x) * (x * x - 2.0 * x) / (2.0 * nu)
        assert np.all(np.abs(rho - np.exp(-x) - first) < 12.0 * x / nu**2)
        assert np.all(np.abs(complement + np.expm1(-x) + first) < 12.0 * x / nu**2)


# -- limits of the surface


@pytest.mark.parametrize("C", [1.2, 2.0, 5.0, 300.0])
def test_a_knee_far_beyond_the_horizon(C):
    for b in (1e-3, 1e-5, 1e-6):
        mirror = judge.mirror(1e-6, b * WAVELENGTH, C)
        first_order = 1e-6 * math.sqrt(0.5 * (C - 1.0)) * b
        assert relative_rms(mirror, WAVELENGTH) == pytest.approx(first_order, rel=C * b * b)


@pytest.mark.parametrize("C", [1.2, 2.0, 5.0, 300.0])
def test_a_knee_far_below_the_horizon(C):
    r = np.array([0.0, WAVELENGTH, 1.0])
    for b in (1e5, 1e8, 1e11):
        mirror = judge.mirror(1.0 / K, b * WAVELENGTH, C)
        lost = b ** (1.0 - C)
        assert relative_rms(mirror, WAVELENGTH) * K == pytest.approx(1.0, rel=lost)
        # what is left of 1 - rho at u = 2 pi r/B bounds how far H is from 1
        fallen = 1.0 - surface_transfer_function(r, mirror, WAVELENGTH)
        exponent = decorrelation(2.0 * math.pi * r / (b * WAVELENGTH), 0.5 * (C - 1.0))
        assert np.all((fallen >= 0.0) & (fallen <= exponent + 3e-16))  # rounding next to 1


@pytest.mark.parametrize("C", [1.0 + 1e-4, 1.05, 1.8, 3.0, 6.0, 12.0])
def test_smooth_surfaces_scatter_once(C):
    for g in (1e-13, 1e-14):
        mirror = judge.mirror(math.sqrt(g) / K, 1.0, C)
        beta = np.array([1e-3, 0.3, 1.0, 30.0, 1e4]) * WAVELENGTH
        b = beta / WAVELENGTH
        S2 = g * (C - 1.0) / (2.0 * math.pi) * (1.0 + b * b) ** (-0.5 * (C + 1.0)) / WAVELENGTH**2
        np.testing.assert_allclose(
            bsdf(beta, mirror, WAVELENGTH), S2, rtol=1e-12
        )  # the promise; twofold light is 1e-13
    for g in (1e-20, 1e-300):
        mirror = judge.mirror(math.sqrt(g) / K, 1.0, C)
        assert total_integrated_scatter(mirror, WAVELENGTH) == phase_variance(mirror, WAVELENGTH) > 0.0
        assert surface_transfer_function(np.array([1e-3, 1e3]), mirror, WAVELENGTH).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("C", [1.5, 2.0, 2.6])
def test_rough_surfaces_of_flat_spectra_tend_to_a_stable_law(C):
    nu, B = 0.5 * (C - 1.0), 1e6
    scale = math.gamma(1.0 - nu) / math.gamma(1.0 + nu)
    for a in (1e3, 1e5, 1e7):
        half = (np.array([0.01, 0.3, 1.0, 30.0]) / (a * scale)) ** (0.5 / nu)  # of u
        mirror = judge.mirror(math.sqrt(a) / K, B, C)
        beyond = a * KCorrelation(1.0, B, C).band_share(1.0 / WAVELENGTH, math.inf)
        found = beyond - transfer_exponent(half * B / math.pi, mirror, WAVELENGTH)
        # the next term of 1 - rho is x/(nu - 1), x = half^2, and later ones are smaller
        bound = half ** (2.0 - 2.0 * nu) / (scale * (1.0 - nu)) + 1e-12
        assert np.all(np.abs(found / (a * scale * half ** (2.0 * nu)) - 1.0) < bound)
        assert phase_variance(mirror, WAVELENGTH) == pytest.approx(a - beyond, rel=1e-12)


@pytest.mark.parametrize("C", [3.5, 5.0, 8.0, 1000.0])
def test_rough_surfaces_of_steep_spectra_tend_to_a_gaussian(C):
    nu, B = 0.5 * (C - 1.0), 1e3
    for a in (1e3, 1e5, 1e7):
        x = np.array([0.01, 0.3, 1.0, 30.0]) * (nu - 1.0) / a  # u^2/4
        found = -transfer_exponent(np.sqrt(x) * B / math.pi, judge.mirror(math.sqrt(a) / K, B, C), WAVELENGTH)
        # the next term is of order t^2, t = x/(nu - 1), or of order x^nu where C < 5, with a logarithm at C = 5
        t = x / (nu - 1.0)
        bound = 4.0 * t ** min(1.0, nu - 1.0) * (1.0 - np.log(t)) + 1e-12
        assert np.all(np.abs(found / (a * x / (nu - 1.0)) - 1.0) < bound)


def test_next_to_the_clip_no_more_is_lost_than_the_rounding_of_what_cancels():
    random = Random("clip")
    for _ in range(60):
        sigma, C, B = (
            math.sqrt(10.0 ** random.uniform(2, 6)) / K,
            random.uniform(1.02, 4.0),
            WAVELENGTH * 10.0 ** random.uniform(0, 2),
        )
        mirror = judge.mirror(sigma, B, C)
        low, high = 1e-12 * WAVELENGTH, 1e4 * WAVELENGTH
        for _ in range(100):  # to where the exponent changes sign
            r = math.sqrt(low * high)
            low, high = (r, high) if transfer_exponent(np.array([r]), mirror, WAVELENGTH)[0] > 0.0 else (low, r)
        r = high * (1.0 + 10.0 ** random.uniform(-9, -4))
        H = exact.transfer(sigma, B, C, WAVELENGTH, r)[2]
        if H < 1e-300:
            continue
        (found,) = surface_transfer_function(np.array([r]), mirror, WAVELENGTH)
        promise = 1e-12 * max(1.0, -float(mpmath.log(H))) + 1e-14 * (K * sigma) ** 2
        assert abs(float(found / H) - 1.0) <= promise


def test_narrow_bands_keep_their_digits():
    term = KCorrelation(1.0, 2.0, 2.4)
    for width in (1e-3, 1e-8, 1e-13):
        f1 = 5.0
        f2 = f1 + width
        with mpmath.workdps(50):
            low, high = ((1 + (2 * mpmath.mpf(f)) ** 2) ** -((mpmath.mpf(2.4) - 1) / 2) for f in (f1, f2))
            assert term.band_share(f1, f2) == pytest.approx(float(low - high), rel=1e-14)


# -- BSDF


def test_a_bsdf_is_right_or_refused():
    met, refused = 0, 0
    for C, g in (
        (8.0, 3.0),
        (8.0, 15.0),
        (10.0, 0.83),
        (10.0, 6.0),
        (12.0, 3.0),
        (14.0, 0.83),
        (20.0, 2.0),
        (50.0, 1.0),
    ):
        sigma = math.sqrt(g) / K
        for b in (0.01, 3.0, 30.0):
            try:
                (found,) = bsdf(np.array([b * WAVELENGTH]), judge.mirror(sigma, 1.0, C), WAVELENGTH)
            except MixtureError:
                refused += 1
                continue
            met += 1
            # the promise
            assert found == pytest.approx(float(exact.bsdf(b * WAVELENGTH, sigma, 1.0, C, WAVELENGTH)), rel=1e-8)
    assert met >= 6
    assert refused + met == 24


def test_a_bsdf_of_more_scatterings_than_the_mixture_takes_is_refused():
    with pytest.raises(MixtureError, match="phase variance"):
        bsdf(np.array([1e-4]), judge.mirror(math.sqrt(2000.0) / K, 1.0, 2.0), WAVELENGTH)


def test_the_page_names_tests_that_exist():
    page = (ROOT / "docs" / "extremes.md").read_text(encoding="utf-8")
    named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", page)
    assert len(named) > 20
    for file, test in named:
        assert f"\ndef {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), f"{file}::{test}"
