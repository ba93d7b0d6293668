"""The rays: what is drawn follows its closed form, what is counted is counted rightly, and errors are as told."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import psfcli
from psfcli.montecarlo.estimate import BATCHES, ensquared_energy
from psfcli.montecarlo.pupil import FAN
from psfcli.montecarlo.sequence import QuasiRandom
from psfcli.montecarlo.spectrum import directions, poisson_tail, repeatedly, scatterers
from psfcli.montecarlo.squares import NestedSquares
from psfcli.montecarlo.third_order import ThirdOrderRays
from psfcli.surface.harvey_shack import phase_variance
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Pupil, Telescope
from tests.truth.cases import REFERENCE, reference_rows

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
WAVELENGTH = 9.4e-6
NO_ABERRATIONS = Telescope(0.05, Pupil(0.3), SeidelTable(), 0.01, 1000.0)


def mirror(*terms, height=50.0, **more):
    return Surface("mirror", height, tuple(KCorrelation(*term) for term in terms), **more)


def rough(g, B=1.0, C=1.8, wavelength=WAVELENGTH):
    """A mirror that scatters ``g`` times in the mean, all but exactly."""
    return mirror((math.sqrt(g) * wavelength / (4.0 * math.pi), B, C))


def p_value(drawn, distribution):
    return stats.kstest(drawn, distribution).pvalue


# -- what is drawn


@pytest.mark.parametrize(("B", "C"), [(1.0, 1.8), (100.0, 1.05), (0.002, 2.5), (1e-5, 1.5), (1.0, 8.0), (3.0, 400.0)])
def test_spatial_frequencies_follow_the_spectrum_below_the_horizon(B, C):
    (term,) = scatterers(mirror((1e-7, B, C)), WAVELENGTH)
    limit = 1.0 / WAVELENGTH

    def below(f, slope=C):  # the share of the variance below f: that of a band, of all that scatters
        nu = 0.5 * (slope - 1.0)
        return (1.0 - (1.0 + (B * f) ** 2) ** -nu) / (1.0 - (1.0 + (B * limit) ** 2) ** -nu)

    for f in (
        term.frequencies(np.random.default_rng(1), 200_000),
        term.frequencies_at(np.random.default_rng(2).random(200_000)),
    ):
        assert f.max() <= limit * (1.0 + 1e-12)
        assert p_value(f, below) > 1e-3
        # and it would have shown if frequencies were wrong by 2 % or the slope by a tenth
        wrong = p_value(1.02 * f, below), p_value(f, lambda f: below(f, 1.0 + 1.1 * (C - 1.0)))
        assert min(wrong) < 1e-6


def test_both_ways_to_a_spatial_frequency_are_one_distribution():
    (term,) = scatterers(mirror((1e-7, 1.0, 1.8)), WAVELENGTH)
    uniform = np.array([0.0, 0.5, 1.0 - 2.0**-53])
    share = 1.0 - uniform * (1.0 - (1.0 + (1.0 / WAVELENGTH) ** 2) ** -0.4)
    assert term.frequencies_at(uniform) == pytest.approx(np.sqrt(share ** (-2.0 / 0.8) - 1.0), rel=1e-12)


@pytest.mark.parametrize("g", [1e-9, 0.83, 6.0, 300.0])
def test_the_number_of_scatterings_is_poissons(g):
    (term,) = scatterers(rough(g), WAVELENGTH)
    tail = poisson_tail(term.mean)
    n = np.arange(tail.size)
    assert tail == pytest.approx(stats.poisson.sf(n, term.mean), rel=1e-9)
    assert stats.poisson.sf(tail.size, term.mean) <= 2.0**-53
    u = np.random.default_rng(3).random(50_000)
    times = np.zeros(u.size)
    for ray in repeatedly(tail, u):
        times[ray] += 1
    # each tail probability passed is one more scattering
    assert np.array_equal(times, np.sum(u[:, None] < tail, axis=1))


@pytest.mark.parametrize(
    "surface",
    [
        mirror((1e-6, 1.0, 1.8), (3e-7, 0.01, 2.5), (1e-7, 1e-5, 1.3)),
        mirror((1e-6, 1.0, 1.8), incidence=0.15),
        mirror((1e-6, 1e-5, 1.8), index_before=1.5, index_after=1.5),
        mirror((1e-4, 1.0, 1.8), is_mirror=False, index_before=1.0, index_after=1.45),
        mirror((1e-4, 1e-5, 1.8), is_mirror=False, index_before=1.45, index_after=1.0),
    ],
)
def test_the_mean_number_is_the_phase_variance(surface):
    # of the production route: two programs for one closed form
    means = sum(term.mean for term in scatterers(surface, WAVELENGTH))
    assert means == pytest.approx(phase_variance(surface, WAVELENGTH), rel=1e-12)


def test_directions_are_even_and_of_length_one():
    x, y = directions(np.random.default_rng(4), 200_000)
    assert np.hypot(x, y) == pytest.approx(np.ones(x.size), abs=3e-7)
    assert p_value(np.arctan2(y, x) / (2.0 * math.pi) + 0.5, "uniform") > 1e-3


@pytest.mark.parametrize("dimensions", [2, 6, 26])
def test_quasi_random_points_are_even_in_every_coordinate(dimensions):
    points = QuasiRandom.drawn(np.random.default_rng(5), dimensions).points(slice(None), 0, 4096)
    assert points.min() >= 0.0
    assert points.max() < 1.0
    gaps = np.diff(np.sort(points, axis=1), axis=1)
    # a gap is at most 1 + the largest partial quotient of a root below 101 (20) times the mean; by chance ln(4096)
    assert gaps.max() < 21.0 / 4096
    later = QuasiRandom.drawn(np.random.default_rng(5), dimensions).points(slice(1, 2), 1000, 10)
    assert np.array_equal(later[0], points[1, 1000:1010])


def test_unscattered_rays_light_the_pupil_evenly():
    # a pure defocus maps the pupil onto the image: rho^2 is the share of the area
    defocus = Telescope(0.05, Pupil(0.3, (0.5, 2.0)), SeidelTable(W020=-0.5 * 0.05), 0.01, 1000.0)
    rays = ThirdOrderRays(defocus, [], WAVELENGTH, Field(0.0))
    x, y = (np.concatenate(c) for c in zip(*rays.landings(np.random.default_rng(6), FAN * 5000), strict=True))
    area = (x**2 + y**2 - 0.09) / 0.91
    azimuth = (np.arctan2(y, x) - 0.5) / 1.5
    for even in (area, azimuth):
        assert np.abs(np.sort(even) - (np.arange(even.size) + 0.5) / even.size).max() < 1e-3


# -- what is counted


@pytest.mark.parametrize(
    "half_width", [[0.3], [1e-4, 0.01, 0.5, 0.5000001, 0.50001, 0.51, 7.0], np.geomspace(1e-4, 10, 400)]
)
def test_nested_squares_count_as_comparing_does(half_width):
    generator = np.random.default_rng(7)
    x, y = generator.standard_cauchy(5000), generator.standard_cauchy(5000)
    x[:4] = 0.3, 0.1, 0.0, np.inf
    y[:4] = 0.0, 0.3, 0.0, np.inf
    half_width = np.array(half_width)
    x[4 : 4 + half_width.size] = half_width[: x.size - 4] + 0.1  # on an edge but for rounding, and exactly on it
    y[4 : 4 + half_width.size] = 0.0
    for centre in ((0.0, 0.0), (0.1, -0.2)):
        reach = np.maximum(np.abs(x - centre[0]), np.abs(y - centre[1]))
        expected = [np.count_nonzero(reach <= w) for w in half_width]
        assert NestedSquares(half_width).inside(x, y, centre).tolist() == expected


def test_the_specular_fraction_is_that_of_poissons_law():
    surfaces = [rough(0.7, B=1e3), rough(0.4, B=1e3, C=3.0)]  # so narrow that a box of 1e-9 mm holds the point alone
    rays = ThirdOrderRays(NO_ABERRATIONS, [rough(0.7), rough(0.4, C=3.0)], WAVELENGTH, Field(0.0))
    found = ensquared_energy(rays, np.array([1e-9]), [(0.0, 0.0)], 400_000, seed=(8,))
    g = sum(phase_variance(s, WAVELENGTH) for s in surfaces)
    expected = math.exp(-sum(phase_variance(s, WAVELENGTH) for s in rays.surfaces))
    assert g == pytest.approx(1.1, rel=1e-3)
    assert found.energy[0, 0] == pytest.approx(expected, abs=4.0 * found.standard_error[0, 0])
    assert found.standard_error[0, 0] < math.sqrt(expected * (1.0 - expected) / found.rays)


def test_one_scattering_of_one_mirror_is_the_spectrum_in_closed_form():
    # g -> 0: the light outside a circle is g times the share of the spectrum beyond; a box lies between two circles
    rays = ThirdOrderRays(NO_ABERRATIONS, [rough(0.01)], WAVELENGTH, Field(0.0))
    w = np.geomspace(1e-4, 10.0, 30)
    found = ensquared_energy(rays, w, [(0.0, 0.0)], 1_000_000, seed=(9,))
    scale = WAVELENGTH * NO_ABERRATIONS.magnified_distance(50.0)
    g = phase_variance(rough(0.01), WAVELENGTH)

    def outside(r):
        (term,) = rough(0.01).psd
        return g * term.band_share(min(r / scale, 1.0 / WAVELENGTH), 1.0 / WAVELENGTH)

    for i, half_width in enumerate(w):
        spread = 4.0 * found.standard_error[0, i] + 0.6 * g**2  # twice scattered light
        assert outside(math.sqrt(2.0) * half_width) - spread <= 1.0 - found.energy[0, i]
        assert 1.0 - found.energy[0, i] <= outside(half_width) + spread


def test_standard_errors_are_those_of_repeated_estimates():
    system = psfcli.load(CONFIGS / "euv_two_mirror.yaml")
    rays = ThirdOrderRays(system.telescope, system.surfaces, WAVELENGTH, system.fields[-1])
    w = np.geomspace(0.003, 3.0, 8)
    found = [ensquared_energy(rays, w, [(0.0, 0.0)], 30_000, seed=(10, k)) for k in range(40)]
    scatter = np.std([e.energy[0] for e in found], axis=0, ddof=1)
    told = np.sqrt(np.mean([e.standard_error[0] ** 2 for e in found], axis=0))
    # 40 repetitions know their scatter to 11 %
    assert scatter / told == pytest.approx(np.ones(w.size), abs=0.45)


@pytest.mark.parametrize("name", REFERENCE)
def test_rays_agree_with_the_reference_systems(name):
    # energies from quadrature to 1e-8, by a program that shares nothing with this one
    truth = REFERENCE[name]
    system = psfcli.load(CONFIGS / "euv_two_mirror.yaml")
    rows = reference_rows(name)
    assert rows
    C = 2.0 if name.endswith("C2") else 1.8
    (sigma,) = {t.sigma for s in truth.surfaces for t in s.terms}
    surfaces = [mirror((sigma, 1.0, C), height=h) for h in (95.0, 34.9885)]
    telescope = system.telescope if truth.seidel else Telescope(95.0 / 1750.0, Pupil(0.48), SeidelTable(), 0.01, 1750.0)
    field = Field(system.telescope.max_field * truth.field[1])
    rays = ThirdOrderRays(telescope, surfaces, truth.wavelength, field)
    w = np.array([row["half_width_um"] for row in rows]) * 1e-3
    found = ensquared_energy(rays, w, [(0.0, 0.0)], 2_000_000, seed=(11,))
    expected = np.array([row["ensquared_energy"] for row in rows])
    floor = (1.0 + np.sqrt(np.minimum(25.0, found.rays * (1.0 - expected)))) / found.rays
    deviation = (found.energy[0] - expected) / np.maximum(found.standard_error[0], floor)
    assert np.abs(deviation).max() < 4.0


def test_the_seed_alone_decides_the_numbers():
    system = psfcli.load(CONFIGS / "three_mirror.yaml")
    rays = ThirdOrderRays(system.telescope, system.surfaces, system.wavelengths[0], system.fields[-1])
    w = np.geomspace(1e-3, 1.0, 20)
    found = [
        ensquared_energy(rays, w, [(0.0, 0.0), (0.01, 0.0)], 20_000, seed=seed, jobs=jobs)
        for seed, jobs in (((1, 0), 1), ((1, 0), 2), ((2, 0), 1), ((1, 1), 1))
    ]
    assert np.array_equal(found[0].energy, found[1].energy)
    assert np.array_equal(found[0].standard_error, found[1].standard_error)
    for other in found[2:]:
        assert not np.array_equal(found[0].energy, other.energy)


def test_whole_batches_of_whole_fans_are_traced_and_told():
    rays = ThirdOrderRays(NO_ABERRATIONS, [], WAVELENGTH, Field(0.0))
    done = []
    found = ensquared_energy(rays, np.array([1.0]), [(0.0, 0.0)], 10_000, seed=(1,), progress=done.append)
    assert found.rays == sum(done) == BATCHES * FAN * 5
    assert found.energy[0, 0] == 1.0
    assert found.lost == 0.0
