"""The scattered light S(r) of the product against the judge's: core, wing and horizon."""

import functools

import numpy as np
import pytest
from truth import scatter_psf
from truth.cases import WAVELENGTH, one_mirror
from truth.contour import scatter_psf_mpmath
from truth.halo import SYSTEMS, knee, radii, rows
from truth.horizon import missing_psf
from truth.scatter import encircled_fftlog, scatter_psf_fftlog
from truth.system import TruthSystem, mirror, sigma_for_phase_variance, specular_weight

from psfcli.image.scatter import Halo, scattered_light
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Pupil, Telescope
from psfcli.tolerance import PRESETS

SLOPE = 0.05


def produced(system: TruthSystem, accuracy: str = "reference", reach: float | None = None) -> Halo:
    """The product's halo for distances up to ``reach`` (default: 0.3 of the first d)."""
    telescope = Telescope(SLOPE, Pupil(), SeidelTable(), 0.01, 1750.0)
    surfaces = [
        Surface(f"number {i}", s.d * SLOPE, tuple(KCorrelation(*term) for term in s.terms))
        for i, s in enumerate(system.surfaces)
    ]
    reach = reach or 0.3 * system.surfaces[0].d
    return scattered_light(surfaces, telescope, system.wavelength, reach, PRESETS[accuracy])


@functools.cache
def table(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Radii [mm] and S there [1/mm^2], with the clip, from reference/halo.csv."""
    listed = [(row["r_mm"], row["scatter_per_mm2"]) for row in rows() if row["system"] == name]
    r, s = np.array(listed).T
    return r, s - missing_psf(SYSTEMS[name], r)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("accuracy", PRESETS)
def test_the_halo_is_exact_over_nine_decades(name, accuracy):
    r, s = table(name)
    assert s.max() / s.min() > 1e9 or r.max() >= 0.3 * SYSTEMS[name].surfaces[0].d
    # asked for is the error of a whole pixel: the halo has to leave room for the other steps
    np.testing.assert_allclose(produced(SYSTEMS[name], accuracy).mixture.density(r), s, rtol=PRESETS[accuracy].pixel)


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_core_is_what_a_log_hankel_transform_gives(name):
    system = SYSTEMS[name]
    r, s = scatter_psf_fftlog(system, 8192)
    # FFTLog's error is a floor: compared with the contour below 1e-9 of S where S is above 1e-3 of its peak, unless
    # the light is concentrated in a knee two decades narrower than another, hence 1e-8
    core = (r > 1e-4 * knee(system)) & (s > 1e-3 * np.max(s[r > 1e-4 * knee(system)]))
    some = np.flatnonzero(core)[:: max(1, np.count_nonzero(core) // 200)]
    np.testing.assert_allclose(produced(system).mixture.density(r[some]), s[some], rtol=1e-6)


def test_the_stored_values_can_be_made_again():
    for name, k in (("C=2.5", 1), ("C=1.5", 3), ("two mirrors", 2)):
        r, _ = table(name)
        assert r.tolist() == radii(SYSTEMS[name])
        again = float(scatter_psf_mpmath(SYSTEMS[name], r[k]))
        stored = [row["scatter_per_mm2"] for row in rows() if row["system"] == name][k]
        assert stored == pytest.approx(again, rel=1e-11)  # asked for to 12 digits


@pytest.mark.parametrize("C", [1.2, 2.0, 4.0])
@pytest.mark.parametrize("share", [0.03, 0.1, 0.2, 0.3])
def test_the_clip_at_the_horizon_is_in_the_halo_to_three_tenths_of_the_distance(C, share):
    system = one_mirror(0.83, 1e-3, C)  # B = 100 wavelengths
    r = share * system.surfaces[0].d
    lost = missing_psf(system, r) / scatter_psf(system, r)
    if share == 0.3:
        assert lost > 2e-6  # so that leaving it out would be seen below
    assert produced(system).mixture.density(r) == pytest.approx(float(scatter_psf(system, r)), rel=1e-6)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("reach_in_distances", [1e-4, 0.3])
def test_weights_are_positive_but_for_the_few_that_hold_the_horizon(name, reach_in_distances):
    system = SYSTEMS[name]
    mixture = produced(system, reach=reach_in_distances * system.surfaces[0].d).mixture
    negative = mixture.weight < 0.0
    assert np.count_nonzero(negative) <= 8  # as many as the horizon's fit has within d_j
    assert np.all(mixture.variance > 0.0)
    if np.any(negative):  # wider than a fiftieth of d: nothing of the image's size among them
        assert np.sqrt(mixture.variance[negative].min()) > 0.02 * system.surfaces[0].d
    r = np.geomspace(1e-3 * knee(system), reach_in_distances * system.surfaces[0].d, 300)
    assert np.all(np.diff(mixture.density(r)) < 0.0)


@pytest.mark.parametrize("name", ["C=1.2", "C=8.0", "two mirrors", "very rough and steep"])
def test_a_shorter_reach_and_a_longer_one_agree_where_both_hold(name):
    system = SYSTEMS[name]
    short = 30.0 * knee(system)
    r = np.geomspace(0.01 * knee(system), short, 40)
    near, far = produced(system, reach=short).mixture, produced(system).mixture
    np.testing.assert_allclose(near.density(r), far.density(r), rtol=1e-6)  # reference, both


@pytest.mark.parametrize("name", ["C=1.5", "almost smooth", "very rough", "two terms"])
def test_encircled_energy_of_the_mixture_is_that_of_the_transform(name):
    system = SYSTEMS[name]
    mixture = produced(system).mixture
    radius = knee(system) * np.array([0.1, 1.0, 10.0, 1000.0])
    inside = -np.expm1(-0.5 * radius[:, None] ** 2 / mixture.variance) @ mixture.weight
    np.testing.assert_allclose(inside, encircled_fftlog(system, radius), atol=1e-8)  # the energy of `reference`


def test_the_specular_fraction_is_what_no_surface_scatters():
    for system in SYSTEMS.values():
        assert produced(system).specular_fraction == pytest.approx(specular_weight(system), rel=1e-13)


def test_random_systems_meet_each_accuracy_in_the_core():
    # 1 to 3 terms a mirror, slopes 1.1 to 8, g from 1e-6 to 6, knees over a decade and a half
    rng = np.random.default_rng(5)
    K = mirror(WAVELENGTH, 1.0).K
    for _ in range(12):
        surfaces = []
        for d in (1750.0, 640.0)[: rng.integers(1, 3)]:
            terms = []
            for _ in range(rng.integers(1, 4)):
                g, B, C = 10.0 ** rng.uniform(-6.0, 0.6), 10.0 ** rng.uniform(-0.75, 0.75), rng.uniform(1.1, 8.0)
                terms.append((sigma_for_phase_variance(g, K, WAVELENGTH, B, C), B, C))
            surfaces.append(mirror(WAVELENGTH, d, *terms))
        system = TruthSystem(WAVELENGTH, tuple(surfaces))
        r, s = scatter_psf_fftlog(system, 8192)
        near = (r > 1e-4) & (s > 1e-3 * np.max(s[r > 1e-4]))
        for accuracy, asked in PRESETS.items():
            density = produced(system, accuracy).mixture.density(r[near][::37])
            np.testing.assert_allclose(density, s[near][::37], rtol=asked.pixel, err_msg=f"{system}")
