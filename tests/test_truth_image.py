"""The quick judge judged: closed forms, and the slow judge, which shares neither its contours nor its rules."""

import itertools
import math

import mpmath
import numpy as np
import pytest
from truth.cases import REFERENCE, one_mirror, paper_telescope, reference_rows
from truth.contour import scatter_psf_mpmath
from truth.contours import STEP, by_every_contour, clipped
from truth.correlation import correlation_on_the_cut, correlation_parts, decorrelation, decorrelation_mpmath
from truth.ensquared import box_energy, pixel_energy
from truth.geometry import pupil_rule, ray_error
from truth.halo import SYSTEMS, rows
from truth.horizon import missing_psf
from truth.image import Image
from truth.pupil import pupil_mean
from truth.radial import radial_scatter
from truth.random_systems import drawn
from truth.rectangle import along_edges, energy_about
from truth.scatter import scatter_psf_fftlog
from truth.scenes import judged
from truth.specular import specular_energy
from truth.system import TruthSystem, mirror, phase_variance, sigma_for_phase_variance

PAPER = REFERENCE["euv_field05"]


def unclipped_exponential_corner(system: TruthSystem, x: float, y: float) -> float:
    """C = 2: energy of the unclipped S in 0..x, 0..y; n/(2 pi (n^2 + b^2)^1.5) has an arctangent there, odd in both."""
    (surface,) = system.surfaces
    (term,) = surface.terms
    g, weight = phase_variance(system.wavelength, surface), (surface.K * term.sigma) ** 2
    n = np.arange(1, 80)
    poisson = np.exp(n * math.log(weight) - g - np.array([math.lgamma(k + 1.0) for k in n]))
    knee = n * system.wavelength * surface.d / term.B
    return float(poisson @ np.arctan(x * y / (knee * np.sqrt(knee**2 + x * x + y * y)))) / (2.0 * math.pi)


# -- S(r) in doubles


def test_complex_correlations_keep_their_digits():
    size = np.array([1e-9, 1e-4, 0.1, 0.29, 0.31, 3.0, 50.0])
    for nu, turn in itertools.product((0.025, 0.5, 1.0, 1.003, 1.3, 3.5), (0.0, 0.2, 0.4)):
        u = size * np.exp(1j * math.pi * turn)
        with mpmath.workdps(30):
            exact = np.array([complex(decorrelation_mpmath(mpmath.mpc(complex(v)), nu)) for v in u[2:]])
        np.testing.assert_allclose(correlation_parts(u, nu)[0][2:], exact, rtol=2e-14)
        np.testing.assert_allclose(correlation_parts(size + 0j, nu)[0].real, decorrelation(size, nu), rtol=1e-12)
        real, imaginary = correlation_on_the_cut(size, nu)
        nearly = correlation_parts(size * np.exp(1j * math.pi * (0.5 - 1e-11)), nu)[0]  # just off the cut
        np.testing.assert_allclose(real, nearly.real, atol=1e-8 * np.abs(nearly).max())
        np.testing.assert_allclose(-imaginary, nearly.imag, atol=1e-8 * np.abs(nearly).max())


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_the_table_is_the_contour_in_mpmath(name):
    stored = [(row["r_mm"], row["scatter_per_mm2"]) for row in rows() if row["system"] == name]
    r, unclipped = np.array(stored).T
    halo = radial_scatter(SYSTEMS[name], 1.1 * r.max())
    exact = unclipped - missing_psf(SYSTEMS[name], r)
    np.testing.assert_allclose(halo.psf(r * r), exact, rtol=1e-9)  # 5e-10 measured at C = 8, 1e-11 in the others


def test_where_a_core_of_multiple_scatter_gives_way_to_a_steep_wing_the_table_is_the_contour_in_mpmath():
    # between radii 0.08 apart in ln r, splines of degree 7 missed 4e-7 here
    system = one_mirror(8.1, 1.0, 7.3)
    r = np.array([0.08, 0.092, 0.103])
    halo = radial_scatter(system, 3.0)
    exact = [float(scatter_psf_mpmath(system, radius, digits=10)) for radius in r]
    np.testing.assert_allclose(halo.psf(r * r), exact, rtol=5e-11)  # 2e-11 measured
    assert halo.worst < 1e-10


def test_between_a_core_and_a_steep_wing_beside_a_faint_wide_term_the_table_is_the_contour_in_mpmath():
    # near 28 knees rays from the origin have lost their digits, and the cut alone, where the faint term turns h(it) ten
    # times as fast as the first, cannot go far enough: the table was refused
    terms = ((3.0, 1.0, 8.0), (1e-8, 0.1, 6.0))  # half-odd orders: quick in mpmath
    K = mirror(1e-5, 1.0).K
    rough = ((sigma_for_phase_variance(g, K, 1e-5, B, C), B, C) for g, B, C in terms)
    system = TruthSystem(1e-5, (mirror(1e-5, 1000.0, *rough),))
    r = np.array([0.15, 0.28])
    halo = radial_scatter(system, 3.0)
    exact = [float(scatter_psf_mpmath(system, radius, digits=10)) for radius in r]
    np.testing.assert_allclose(halo.psf(r * r), exact, rtol=5e-11)  # 2e-12 measured
    assert halo.worst < 2e-10


def test_where_a_steep_wing_sinks_into_the_plateau_of_a_far_wider_term_the_table_is_the_contour_in_mpmath():
    # the knees are 5e4 apart: rays keep no more than eight digits, and the wide term turns h(it) too fast for the cut
    K = mirror(1e-5, 1.0).K
    narrow, wide = (
        mirror(1e-5, d, (sigma_for_phase_variance(g, K, 1e-5, B, C), B, C))
        for d, g, B, C in ((1000.0, 1e-5, 10.0, 6.0), (1e4, 2e-6, 2e-3, 2.0))
    )
    system = TruthSystem(1e-5, (narrow, wide))
    r = np.array([0.03, 0.06])
    halo = radial_scatter(system, 3.0)
    exact = [float(scatter_psf_mpmath(system, radius)) for radius in r] - missing_psf(system, r)
    np.testing.assert_allclose(halo.psf(r * r), exact, rtol=1e-11)  # 4e-13 measured, as asked of mpmath
    assert halo.worst < 2e-10


def test_a_table_that_ends_where_a_steep_wing_sinks_into_a_plateau_is_the_contour_in_mpmath_up_to_its_reach():
    # its splines err by 2e-9 in their last intervals, beyond the reach, and for that the table was refused; and on a
    # plateau, where the slope tells of no tail, the energy beyond the last radius was taken for nought
    K = mirror(1e-5, 1.0).K
    rough = (
        mirror(1e-5, d, (sigma_for_phase_variance(g, K, 1e-5, B, C), B, C))
        for d, g, B, C in ((1e3, 0.03, 3e-3, 8.0), (1e4, 5e-4, 1e-3, 2.0))
    )
    system, reach = TruthSystem(1e-5, tuple(rough)), 12.0
    r = np.array([9.0, 11.999])
    halo, longer = radial_scatter(system, reach), radial_scatter(system, 10.0 * reach)
    exact = float(scatter_psf_mpmath(system, r[1])) - missing_psf(system, r[1:])
    np.testing.assert_allclose(halo.psf(r[1:] ** 2), exact, rtol=5e-12)  # 8e-13 measured
    np.testing.assert_allclose(halo.inside(r * r), longer.inside(r * r), rtol=1e-13)
    # between the two radii, as a constant counts in no rectangle; 5e-6 of it where the logarithm fell to nought
    shell, wider = (-float(np.diff(table.outside(r * r))[0]) for table in (halo, longer))
    assert shell == pytest.approx(wider, rel=1e-10)  # all beyond the longer is fifty times as much
    assert halo.worst < 1e-11


def test_what_rays_leave_out_near_the_origin_is_told():
    # the light of a knee 2e5 times as wide is at 2 pi q r = 1e-9, and the middle of one with C = 1.1 still nearer
    apart = TruthSystem(1e-5, (mirror(1e-5, 1e3, (1e-9, 20.0, 5.0)), mirror(1e-5, 1e4, (2e-8, 1e-3, 3.0))))
    for system in (apart, one_mirror(9.0, 1.0, 1.13)):
        knee = min(system.wavelength * s.d / t.B for s in system.surfaces for t in s.terms)
        with np.errstate(all="ignore"):
            value, noise = by_every_contour(system, math.log(1e-4 * knee) + STEP * np.arange(3))
        told = noise[1:6:2]  # without h(0) subtracted, which has all digits
        assert np.all(told < 1e-12)
        assert np.all(np.abs(value[3:6:2] / value[1] - 1.0) < told[1:] + told[0])


def test_contours_agree_where_several_have_digits_left_whatever_the_terms():
    compared = 0
    for system in (judged(drawn(6, number)) for number in range(25)):
        if not system.surfaces:
            continue
        knees = [system.wavelength * s.d / t.B for s in system.surfaces for t in s.terms]
        log_r = math.log(1e-4 * min(knees)) + STEP * np.arange(int(math.log(1e5 * max(knees) / min(knees)) / STEP))
        with np.errstate(all="ignore"):
            value, noise = by_every_contour(system, log_r)
            best = np.take_along_axis(value, np.argmin(noise, axis=0)[None], 0)[0]
            apart = np.abs(value / best - 1.0)
        good = noise < 1e-8
        compared += np.count_nonzero(good.sum(axis=0) > 1)
        assert np.all(apart[good] < 3.0 * noise[good] + 1e-12)  # the noise is an estimate
    assert compared > 5000


def test_first_order_scatter_has_a_closed_density_and_energy():
    for C in (1.3, 2.2, 3.0, 7.0):
        system = one_mirror(1e-9, 10.0, C)  # multiple scatter: 1e-9 of it
        (surface,) = system.surfaces
        weight, knee = (surface.K * surface.terms[0].sigma) ** 2, 1e-3
        halo = radial_scatter(system, 1.0)
        r = np.geomspace(1e-5, 0.5, 12)
        density = weight * (C - 1.0) / (2.0 * math.pi * knee**2) * (1.0 + (r / knee) ** 2) ** (-0.5 * (C + 1.0))
        energy = -weight * np.expm1(-0.5 * (C - 1.0) * np.log1p((r / knee) ** 2))
        np.testing.assert_allclose(halo.psf(r * r), density, rtol=2e-8 if C < 1.5 else 3e-9)  # g, and the clip
        np.testing.assert_allclose(halo.inside(r * r), energy, rtol=2e-8 if C < 1.5 else 3e-9)


def test_the_shells_hold_all_that_is_scattered():
    for name in ("C=4.0", "C=6.0", "C=8.0", "very rough and steep"):
        halo = radial_scatter(SYSTEMS[name], 3.0)
        assert abs(halo.closure) < 1e-9  # the tail beyond as a power law, 1 - exp(-g) as a sum


def test_the_clipped_contour_agrees_with_fftlog_where_most_lies_beyond_the_horizon():
    rough = one_mirror(8.0, 3e-4, 1.08)  # B = 30 wavelengths: K^2 sigma^2 is 34, and exp(26) of it would cancel
    r, s = (v[::160] for v in scatter_psf_fftlog(rough, points=1 << 16))
    known = (r > 1e-3) & (r < 900.0)
    value, noise = clipped(rough, r[known])
    np.testing.assert_allclose(value, s[known], rtol=3e-7)  # FFTLog's own at the kink of the clip: 1e-6 at 2^14 points
    assert noise.max() < 1e-9
    gentle = one_mirror(0.8, 1.0, 1.8)
    r = np.geomspace(1e-4, 300.0, 12)
    halo = radial_scatter(gentle, 400.0)
    np.testing.assert_allclose(clipped(gentle, r)[0], halo.psf(r * r), rtol=1e-9)


# -- rectangles


WINDOWS = [(-0.3, 0.4, -0.2, 0.5), (0.002, 0.003, -0.001, 0.001), (0.01, 0.011, 0.2, 0.2003), (0.004, 0.9, 0.001, 0.7)]


@pytest.mark.parametrize("window", WINDOWS)
def test_rectangles_of_exponential_correlation_are_arctangents(window):
    system = one_mirror(0.83, 1.0, 2.0)
    x0, x1, y0, y1 = window
    corners = [((x1, y1), 1), ((x0, y1), -1), ((x1, y0), -1), ((x0, y0), 1)]
    exact = math.fsum(sign * unclipped_exponential_corner(system, *corner) for corner, sign in corners)
    assert Image(system, 2.0).scattered(window) == pytest.approx(exact, rel=2e-9)  # the clip: (1 mm/d)^3 = 1e-9


def test_the_three_ways_to_a_rectangle_agree():
    halo = radial_scatter(PAPER, 20.0)
    x, y = np.array([0.003]), np.array([-0.004])
    for window in ((0.5, 0.9, -0.1, 0.3), (0.02, 0.05, -0.004, 0.01), (2.0, 5.0, 1.0, 6.0)):
        edges = [np.linspace(window[i], window[i + 1], 33) for i in (0, 2)]
        fine = [(*a, *b) for a, b in itertools.product(*(itertools.pairwise(e) for e in edges))]
        by_parts = math.fsum(float(energy_about(halo, part, x, y)[0]) for part in fine)  # small: the product rule
        assert float(energy_about(halo, window, x, y)[0]) == pytest.approx(by_parts, rel=1e-9)
        by_edges = along_edges(halo.inside, window, x, y, np.array([halo.core]))
        assert float(by_edges[0]) == pytest.approx(by_parts, rel=1e-9, abs=1e-10)


def test_a_rectangle_is_the_sum_of_its_parts_however_steep_and_rough():
    # the energies of steep spectra, of many times scattered light, are the hardest on rules of fixed order
    for name in ("C=8.0", "very rough", "very rough and steep", "two terms"):
        halo = radial_scatter(SYSTEMS[name], 100.0)
        across = np.array([-6.0, -1.1, -0.3, -1e-3, 0.0, 0.02, 0.7, 5.0, 300.0]) * halo.core
        x, y = (v.ravel() for v in np.meshgrid(across, across))
        wide = 1e3 * halo.core
        whole = energy_about(halo, (0.0, wide, 0.0, wide), x, y)
        cuts = np.array([0.0, 0.13, 1.7, 40.0, 1e3]) * halo.core
        parts = sum(
            energy_about(halo, (*a, *b), x, y) for a in itertools.pairwise(cuts) for b in itertools.pairwise(cuts)
        )
        np.testing.assert_allclose(parts, whole, rtol=1e-9)


def test_the_pupil_rule_finds_a_narrow_gaussian_in_a_wide_spot():
    # defocus alone: the spot is a uniform annulus, on which a narrow Gaussian has its whole integral over the area
    system = TruthSystem(1e-5, (), 0.1, 0.4, {"W020": 5e-4})
    width, area = 2e-5, math.pi * 0.01**2 * (1.0 - 0.4**2)

    def gaussian(x, y, _):
        return np.exp(-0.5 * ((x - 0.006) ** 2 + (y - 0.003) ** 2) / width**2)

    found = pupil_mean(system, gaussian, lambda x, y: (np.full_like(x, width), np.full_like(y, width)))
    assert found == pytest.approx(2.0 * math.pi * width**2 / area, rel=1e-9)


@pytest.mark.parametrize("sector", [None, (0.3, 2.1)])
def test_the_pupil_rule_is_a_product_rule_of_high_order(sector):
    system = paper_telescope(field=1.0).but(sector=sector)
    x, y, w = pupil_rule(system, 40, 160)
    ex, ey = ray_error(system, x, y)
    exact = float(w @ np.cos(300.0 * ex + 200.0 * ey))

    def wave(x, y, _):
        return np.cos(300.0 * x + 200.0 * y)

    found = pupil_mean(system, wave, lambda x, y: (np.ones_like(x), np.ones_like(y)))
    assert found == pytest.approx(exact, abs=1e-10)


# -- the whole


@pytest.mark.parametrize("name", sorted(REFERENCE))
def test_quick_ensquared_energies_are_those_of_reference(name):
    image = Image(REFERENCE[name], 60.0)
    for row in reference_rows(name)[::3]:
        energy = image.square(row["half_width_um"] * 1e-3)
        assert energy == pytest.approx(row["ensquared_energy"], abs=5e-8)  # the table's own digits


@pytest.mark.parametrize("sector", [None, (0.3, 2.1)])
def test_the_quick_judge_agrees_with_the_slow_one(sector):
    system = PAPER.but(sector=sector, field=(0.6, 0.8))
    image = Image(system, 60.0)
    for window in (
        (-0.004, 0.01, 0.001, 0.006),
        (0.02, 0.021, 0.0, 0.003),
        (0.5, 0.521, 0.3, 0.321),
        (3.0, 5.0, -1.0, 2.0),
    ):
        assert image.energy(window) == pytest.approx(pixel_energy(system, *window), rel=1e-9, abs=1e-9)
    assert image.square(0.05, (0.01, 0.0)) == pytest.approx(box_energy(system, 0.05, (0.01, 0.0)), abs=1e-9)


def test_a_tiny_window_in_a_wide_spot_is_found_however_small():
    # defocus: uniform light, of which a square far from the rims takes its share of the area
    system, area = TruthSystem(1e-5, (), 0.1, 0.4, {"W020": 5e-4}), math.pi * 0.01**2 * (1.0 - 0.4**2)
    for half_width in (1e-3, 1e-5, 1e-7):
        window = (0.006 - half_width, 0.006 + half_width, 0.002 - half_width, 0.002 + half_width)
        exact = 4.0 * half_width**2 / area
        assert specular_energy(system, *window, 1e-6 * exact) == pytest.approx(exact, rel=1e-6)
    # several sheets of light: the sum of its parts
    x, y = ray_error(PAPER, 0.3, -0.6)
    window = (x - 1e-5, x + 1e-5, y - 1e-5, y + 1e-5)
    parts = [(x - 1e-5, x + 3e-6, *window[2:]), (x + 3e-6, x + 1e-5, *window[2:])]
    whole = specular_energy(PAPER, *window, 1e-13)
    assert whole == pytest.approx(sum(specular_energy(PAPER, *part, 1e-13) for part in parts), abs=1e-12)
    assert whole > 1e-8


def test_a_tiny_window_is_found_where_light_crowds_along_a_line():
    # a spot whose rays nearly agree along curves: counted on a grid about the rings that reach the window
    system, half_width = judged(drawn(101, 10)), 2.4515111556995332e-05
    p, phi = np.linspace(0.77, 0.80, 3001), np.linspace(-np.pi, np.pi, 6001)
    rho = np.sqrt(0.5 * (p[1:] + p[:-1]))[:, None]
    middle = 0.5 * (phi[1:] + phi[:-1])
    x, y = ray_error(system, rho * np.cos(middle), rho * np.sin(middle))
    counted = np.count_nonzero((np.abs(x) < half_width) & (np.abs(y) < half_width)) / x.size
    share = counted * (p[-1] - p[0]) / (1.0 - system.obscuration**2)
    found = specular_energy(system, -half_width, half_width, -half_width, half_width)
    assert found == pytest.approx(share, rel=1e-2)
    assert found == pytest.approx(8.298925e-6, rel=1e-6)  # by fans in azimuth, good to 1e-11 of all light


@pytest.mark.parametrize("half_width", [1e-7, 1e-6, 1.7345847825e-05, 1e-4])
def test_a_whole_ring_that_focuses_to_a_point_is_found_in_a_tiny_window(half_width):
    # defocus W020 against spherical aberration W040: the ring rho0^2 = -W020/(2 W040) lands on the origin, and
    # |eps| = 4 |W020| |rho - rho0|/u' about it, so that 2 rho0 times the lit width of rho is the share at an azimuth
    system = judged(drawn(12, 863))
    defocus, spherical = system.seidel["W020"], system.seidel["W040"]
    size, ring = defocus / system.image_slope, math.sqrt(-defocus / (2.0 * spherical))
    mean_secant = 4.0 / math.pi * math.asinh(1.0)  # of the angle from the nearest axis: from the middle to the edge
    around_the_centre = half_width**2 / (math.pi * size**2)  # rays near rho = 0, where |eps| = 2 |W020| rho/u'
    exact = ring * half_width / size * mean_secant + around_the_centre
    found = specular_energy(system, -half_width, half_width, -half_width, half_width, 1e-6 * exact)
    assert found == pytest.approx(exact, rel=1e-6)


def test_a_window_touched_by_a_single_ray_is_touched():
    image = Image(TruthSystem(1e-5, (), 0.1, 0.0, {"W020": 5e-4}), 1.0)  # a disc of radius 0.01 mm
    assert image.touches((0.0099, 0.02, -1e-3, 1e-3))
    assert not image.touches((0.0101, 0.02, -1e-3, 1e-3))
    assert image.unscattered((-0.011, 0.011, -0.011, 0.011)) == 1.0


def test_a_system_without_scatter_or_spread_is_a_point():
    bare = Image(TruthSystem(1e-5, (mirror(1e-5, 100.0),)), 1.0)
    assert bare.energy((0.0, 1.0, 0.0, 1.0)) == pytest.approx(0.25, abs=1e-12)
    assert bare.scattered((0.1, 1.0, 0.0, 1.0)) == 0.0
