"""How far the model holds: the numbers of the paper's telescope, each found another way, and what is told of them."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from planned import paper
from scipy import integrate, special

import psfcli
from psfcli import recipe
from psfcli.planning.approximations import airy_diameter, figure_share, kappa, scattered_twice, tis_changes
from psfcli.planning.validity import Criterion
from psfcli.products.compare import compare
from psfcli.surface.harvey_shack import phase_variance
from psfcli.telescope.aberration import aberration_gradient, transverse_aberration_along_azimuths
from psfcli.telescope.system import Field

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
WAVELENGTH = 9.4e-6  # mm
EDGE = math.radians(0.5)


def criteria(system, **options):
    """The criteria by name."""
    return {criterion.name: criterion for criterion in recipe.plan(system, **options).validity}


def prescribed(*fields):
    return psfcli.load(CONFIGS / "euv_prescription.yaml", fields=list(fields))


def landing(telescope, H, rho, azimuth):
    """Where a ray lands [mm], by the cubics in pupil radius that images are traced with."""
    fans = transverse_aberration_along_azimuths(telescope.seidel, H, np.array([azimuth]), telescope.image_slope)
    return np.array([np.polyval(fan[::-1, 0], rho) for fan in fans])


# -- diffraction


def test_the_airy_disc_is_a_hundredth_of_a_pixel():
    found = criteria(paper())
    assert airy_diameter(WAVELENGTH, 95.0 / 1750.0) == pytest.approx(0.21e-3, abs=0.005e-3)  # the paper, Section 4
    assert found["Airy diameter / pixel"].value == pytest.approx(0.010, abs=0.0005)
    assert found["Airy diameter / pixel"].ok


def test_the_airy_diameter_ends_at_the_first_zero_of_the_diffraction_integral():
    aperture, f = 190.0, 1750.0
    k, r = 2.0 * math.pi / WAVELENGTH, 0.5 * airy_diameter(WAVELENGTH, aperture / (2.0 * f))

    def amplitude(radius):
        bessel = lambda rho: special.j0(k * rho * radius / f) * rho  # noqa: E731
        return integrate.quad(bessel, 0.0, aperture / 2.0, epsabs=1e-10)[0]

    assert abs(amplitude(r)) < 1e-9 * amplitude(0.0)
    assert amplitude(0.99 * r) > 0.0 > amplitude(1.01 * r)


def test_the_smallest_spot_is_what_the_disc_is_held_against():
    # rms 3.88 and 1.60 um at 0.25 deg, physics as counted from rays; 5.72, 5.72 on the axis
    spread = criteria(paper(fields=["0 deg", "0.25 deg", "0.5 deg"]))["Airy diameter / spot"]
    assert spread.value == pytest.approx(0.2113 / (2.0 * math.hypot(3.88, 1.60)), rel=0.005)
    axis = criteria(paper(fields=["0 deg"]))["Airy diameter / spot"]
    assert axis.value == pytest.approx(0.2113 / (2.0 * math.hypot(5.72, 5.72)), rel=0.005)


def test_visible_light_on_small_pixels_is_a_warning():
    found = criteria(paper("wavelengths=[500 nm]"))
    assert not found["Airy diameter / pixel"].ok
    perfect = criteria(paper("telescope.seidel={reference_wavelength: 9.4 nm, W020: 0}"))["Airy diameter / spot"]
    assert perfect.value == math.inf
    assert not perfect.ok
    assert json.loads(json.dumps(perfect.report(), allow_nan=False))["ok"] is False


# -- Eq. 42


@pytest.mark.parametrize("H", [(0.0, 0.0), (0.0, 1.0), (0.3, -0.7)])
def test_the_gradient_with_field_is_that_of_the_traced_polynomial(H):
    telescope, step = paper().telescope, 1e-4
    for rho, azimuth in ((1.0, -1.57), (0.48, 0.4), (0.8, 2.5)):
        x, y = np.array(rho * math.cos(azimuth)), np.array(rho * math.sin(azimuth))
        gradient = aberration_gradient(telescope.seidel, H, x, y, telescope.image_slope)
        for axis in (0, 1):
            ahead, behind = (np.array(H) + sign * step * np.eye(2)[axis] for sign in (1.0, -1.0))
            # at most cubic in H: a central difference errs by W311 step^2, 1e-11 mm
            difference = (landing(telescope, ahead, rho, azimuth) - landing(telescope, behind, rho, azimuth)) / (
                2.0 * step
            )
            np.testing.assert_allclose(gradient[:, axis], difference, rtol=1e-7, atol=1e-10)


def test_kappa_is_4e_3_by_displaced_fields():
    telescope = paper().telescope
    value = criteria(paper(fields=["0.5 deg"]))["kappa of Eq. 42"].value
    assert value == pytest.approx(4e-3, abs=0.5e-3)
    # rays scattered by a little come as from fields a little apart, in every direction
    alpha, worst = 1e-6, 0.0
    for rho in np.linspace(0.48, 1.0, 7):
        for azimuth in np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False):
            here = landing(telescope, telescope.relative_field(Field(EDGE)), rho, azimuth)
            for toward in np.linspace(0.0, math.pi, 18, endpoint=False):
                x, y = alpha * math.cos(toward), math.tan(EDGE) + alpha * math.sin(toward)
                scattered = Field(math.atan(math.hypot(x, y)), math.atan2(y, x))
                there = landing(telescope, telescope.relative_field(scattered), rho, azimuth)
                worst = max(worst, math.hypot(*(there - here)) / (1750.0 * alpha))
    assert value == pytest.approx(worst, rel=2e-3)  # steps of 5 and 10 degrees miss up to (5 deg)^2/4 of the maximum


def test_kappa_is_the_same_of_a_prescription_and_unknown_at_finite_conjugates():
    table, built = (criteria(s)["kappa of Eq. 42"].value for s in (paper(fields=["0.5 deg"]), prescribed("0.5 deg")))
    assert built == pytest.approx(table, rel=0.01)  # W311 -5.19 instead of -5.48 waves in 390
    finite = replace(paper().telescope, focal_length=None, max_field=5.0)
    system = replace(paper(), telescope=finite, fields=(Field(1.0),))
    unknown = criteria(system)["kappa of Eq. 42"]
    assert math.isnan(unknown.value)
    assert unknown.ok
    assert "value" not in unknown.report()


def test_kappa_grows_with_aberrations_until_it_is_told():
    telescope = paper().telescope
    strong = paper("telescope.seidel.W222=1500", fields=["0.5 deg"])
    assert kappa(strong.telescope, Field(EDGE), 15.27) > kappa(telescope, Field(EDGE), 15.27)
    assert not criteria(strong)["kappa of Eq. 42"].ok


# -- roughness


@pytest.mark.parametrize("C", [1.2, 1.8, 3.0])
def test_the_figure_share_is_the_integral_below_one_over_the_beam(C):
    surface = paper(f"surfaces.1.psd={{sigma: 1 nm, B: 40 mm, C: {C}}}").surfaces[1]

    def share(low, high):
        spectrum = lambda u: math.exp(2.0 * u) / (1.0 + (40.0 * math.exp(u)) ** 2) ** ((C + 1.0) / 2.0)  # noqa: E731
        return integrate.quad(spectrum, math.log(low), math.log(high), limit=200)[0]

    lowest = 1.0 / (2.0 * 34.9885)
    assert figure_share(surface, WAVELENGTH) == pytest.approx(
        share(1e-12, lowest) / share(1e-12, 1.0 / WAVELENGTH), rel=1e-7
    )


def test_a_correlation_length_near_the_mirror_is_a_warning():
    found = criteria(paper("surfaces.0.psd.B=100 mm"))
    assert not found["figure in psd of primary"].ok
    assert found["figure in psd of secondary"].ok


@pytest.mark.parametrize(("B", "ok"), [("93 nm", False), ("95 nm", True)])
def test_a_correlation_length_below_ten_wavelengths_is_a_warning(B, ok):
    found = criteria(paper(f"surfaces.0.psd={{sigma: 0.1 nm, B: {B}, C: 1.8}}"))
    assert found["wavelength / B of primary"].ok is ok


def test_a_fifth_of_the_light_is_scattered_twice_by_a_mirror():
    value = criteria(paper())["multiple scatter at primary"].value
    assert value == pytest.approx(0.20, abs=0.005)
    g = phase_variance(paper().surfaces[0], WAVELENGTH)
    assert value == pytest.approx(sum(math.exp(-g) * g**n / math.factorial(n) for n in range(2, 60)), rel=1e-13)


@pytest.mark.parametrize("g", [1e-12, 9.9e-5, 1.01e-4, 0.83, 6.0, 800.0])
def test_twice_is_the_sum_of_the_poisson_distribution(g):
    # all terms positive: no cancellation; beyond 400 terms of g = 6 nothing is left, and of g = 800 all has come
    direct = (
        1.0 if g > 100.0 else math.fsum(math.exp(n * math.log(g) - g - math.lgamma(n + 1.0)) for n in range(2, 400))
    )
    assert scattered_twice(g) == pytest.approx(direct, rel=1e-11)


def test_a_pixel_of_21_um_is_a_spatial_frequency_of_1_28_per_mm():
    found = criteria(paper())
    first = found["psd of primary used from [1/mm]"].value
    assert first == pytest.approx(1.28, abs=0.005)
    # the grating equation: light of 9.4 nm goes off by lambda f, and lands f tan of it away
    assert 1750.0 * math.tan(math.asin(WAVELENGTH * first)) == pytest.approx(0.021, rel=1e-9)
    ratio = found["psd of secondary used from [1/mm]"].value / first
    assert ratio == pytest.approx(1.0 / 0.3683, rel=1e-4)


def test_no_spatial_frequency_beyond_the_horizon_is_used():
    wide = paper("ensquared_energy={half_widths: [4 m]}")
    assert criteria(wide)["psd of primary used to [1/mm]"].value == pytest.approx(1.0 / WAVELENGTH)


def test_light_from_beyond_17_degrees_is_a_warning():
    found = criteria(paper("ensquared_energy={half_widths: [500 mm]}"))
    assert not found["sine of scattering at primary"].ok
    assert found["sine of scattering at primary"].value == pytest.approx(math.sqrt(2.0) * 500.0 / 1750.0, rel=1e-3)
    assert not found["sine of scattering at secondary"].ok


# -- what a prescription tells


def test_incidence_lowers_the_tis_by_what_traced_rays_say():
    found = criteria(prescribed("0 deg"))
    primary, secondary = (found[f"TIS off by incidence, {name}"] for name in ("primary", "secondary"))
    # exact rays through the rim, by the normals of the conics: tan = dz/dr = c r/sqrt(1 - (1 + K) c^2 r^2)
    normal = lambda r, R, K: math.atan((r / R) / math.sqrt(1.0 - (1.0 + K) * (r / R) ** 2))  # noqa: E731
    first = abs(normal(95.0, -1466.0206, -1.180053))
    second = abs(2.0 * first - abs(normal(34.99, -929.1389, -8.460356)))
    g = phase_variance(prescribed().surfaces[0], WAVELENGTH)
    for criterion, angle, at_most in ((primary, first, 0.0016), (secondary, second, 0.0032)):
        change = math.exp(-g * math.cos(angle) ** 2) - math.exp(-g)
        assert criterion.value == pytest.approx(change, rel=0.02)  # paraxial against exact angles
        assert criterion.value <= at_most
        assert criterion.ok


def test_the_angle_from_which_on_incidence_matters_is_told_without_a_prescription():
    criterion = criteria(paper())["TIS off by incidence, primary"]
    assert math.isnan(criterion.value)
    assert "from 9.6 deg on" in criterion.advice
    surface = paper().surfaces[0]
    below, above = tis_changes(surface, WAVELENGTH, np.radians([9.5, 9.6]))
    assert below <= 0.01 < above


def test_incidence_that_the_file_allows_for_is_not_counted_again():
    tilted = paper("surfaces.0.incidence=5 deg").surfaces[0]
    assert tis_changes(tilted, WAVELENGTH, np.radians([5.0]))[0] == pytest.approx(0.0, abs=1e-15)
    straight = paper().surfaces[0]
    assert tis_changes(tilted, WAVELENGTH, np.zeros(1))[0] == pytest.approx(
        tis_changes(straight, WAVELENGTH, np.radians([5.0]))[0], rel=1e-12
    )


def test_a_refracting_surface_follows_snell():
    surface = psfcli.load(CONFIGS / "lens.yaml").surfaces[0]
    inside = math.asin(math.sin(0.4) / 1.5168)
    g = phase_variance(surface, 587.6e-6) * ((1.5168 * math.cos(inside) - math.cos(0.4)) / 0.5168) ** 2
    expected = abs(math.exp(-g) - math.exp(-phase_variance(surface, 587.6e-6)))
    assert tis_changes(surface, 587.6e-6, np.array([0.4]))[0] == pytest.approx(expected, rel=1e-10)


def test_scattered_rays_begin_to_miss_the_secondary_beyond_1_3_degrees():
    system = prescribed("0 deg")
    criterion = criteria(system)["distance / vignetting at primary"]
    # the rim ray goes to 34.99 mm; the secondary's shadow, 0.48 of 95 mm, is 10.61 mm wider, 463 mm on
    angle = math.atan((0.48 * 95.0 - 34.99) / 463.0318)
    assert math.degrees(angle) == pytest.approx(1.3, abs=0.05)
    reach = recipe.plan(system).reach
    assert criterion.value == pytest.approx(reach / (1750.0 * angle), rel=1e-4)
    assert "scattered by 1.3 deg" in criterion.advice
    assert criterion.ok
    wide = psfcli.load(CONFIGS / "euv_prescription.yaml", ["ensquared_energy={half_widths: [30 mm]}"], ["0 deg"])
    assert not criteria(wide)["distance / vignetting at primary"].ok  # 42 mm in the corners
    assert "distance / vignetting at secondary" not in criteria(wide)


def test_without_a_prescription_it_is_said_what_is_not_known():
    unknown = criteria(paper())["distance / vignetting"]
    assert math.isnan(unknown.value)
    assert "prescription alone" in unknown.advice
    assert "distance / vignetting" not in criteria(paper("surfaces=[{marginal_height: 95 mm}]"))


# -- how it is told


def test_every_example_keeps_every_criterion():
    for config in sorted(CONFIGS.glob("*.yaml")):
        assert recipe.plan(psfcli.load(config)).warnings == (), config.name


def test_a_criterion_is_exceeded_above_its_threshold_alone():
    for value, ok in ((0.2, True), (0.25, True), (0.2501, False), (math.nan, True), (math.inf, False)):
        assert Criterion("x", value, 0.25, "why").ok is ok
    assert Criterion("x", 1e9, math.inf, "why").ok
    assert Criterion("x", 0.5, 0.25, "why").warning == "x is 0.5, more than 0.25: why"


def test_many_fields_are_no_more_work_than_some():
    few = paper(fields=["0 deg", "0.5 deg"])
    many = tuple(Field(EDGE * i / 2999.0) for i in range(3000))
    value = criteria(replace(few, fields=many))["kappa of Eq. 42"].value
    assert value == criteria(few)["kappa of Eq. 42"].value  # the farthest is among them


BAD = ("--set", "wavelengths=[500 nm]", "--set", "detector.pixels=4", "--format", "fits,csv", "--accuracy", "draft")


@pytest.fixture(scope="module")
def warned(tmp_path_factory):
    """A run whose pixels are too small for its wavelength, and what it said on stderr."""
    directory = tmp_path_factory.mktemp("place") / "run"
    command = [sys.executable, "-m", "psfcli", "run", str(CONFIGS / "euv_two_mirror.yaml"), *BAD, "-o", str(directory)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return directory, done.stderr


def test_a_run_tells_what_exceeds_its_threshold(warned):
    directory, stderr = warned
    assert "note: Airy diameter / pixel is 0.53, more than 0.25: diffraction, 11.2 um wide, is not modelled" in stderr
    manifest = json.loads((directory / "manifest.json").read_text())["plan"]
    listed = {each["criterion"]: each for each in manifest["validity"]}
    assert listed["Airy diameter / pixel"]["ok"] is False
    assert listed["kappa of Eq. 42"]["ok"] is True
    assert listed["Airy diameter / pixel"]["threshold"] == 0.25
    assert len(manifest["warnings"]) == sum(not each["ok"] for each in manifest["validity"])


def test_the_primary_header_says_whether_the_model_holds(warned, tmp_path):
    directory, _ = warned
    with fits.open(directory / "psf.fits") as opened:
        cards = opened[0].header
        opened.verify("exception")
    manifest = json.loads((directory / "manifest.json").read_text())["plan"]
    assert cards["VALID"] is False
    assert [cards[f"WARN{i + 1}"] for i in range(len(manifest["warnings"]))] == manifest["warnings"]
    psfcli.write(paper(), tmp_path / "good", formats=("fits",))
    good = fits.getheader(tmp_path / "good" / "psf.fits")
    assert good["VALID"] is True
    assert not [key for key in good if key.startswith("WARN")]


def test_compare_leaves_the_validity_to_the_reader(warned, tmp_path):
    directory, _ = warned
    other = tmp_path / "psf.fits"
    other.write_bytes((directory / "psf.fits").read_bytes())
    with fits.open(other, mode="update") as opened:
        for key in ("VALID", "WARN1"):
            del opened[0].header[key]
    assert compare(directory / "psf.fits", other).within


def test_plan_prints_every_criterion_with_its_threshold(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "psfcli", "plan", str(CONFIGS / "euv_two_mirror.yaml"), *BAD],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    table = done.stdout.split("validity of the model")[1].split("\n\n")[0].splitlines()[1:]
    printed = [line.split("  ")[0] for line in table]
    system = psfcli.load(CONFIGS / "euv_two_mirror.yaml", ["wavelengths=[500 nm]", "detector.pixels=4"])
    assert printed == list(criteria(system))
    assert [line.split("  ")[0] for line in table if "warning: " in line] == [
        name for name, criterion in criteria(system).items() if not criterion.ok
    ]
    assert "0.53     0.25  warning: diffraction" in done.stdout
