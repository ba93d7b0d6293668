"""The whole pipeline at its limits: reached continuously, judged where they can be, refused with a reason elsewhere."""

from __future__ import annotations

import copy
import math
import re
import subprocess
import sys
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from planned import CONFIGS
from promise import kept, truth_of

import psfcli
from psfcli.recipe import SceneError
from psfcli.surface.harvey_shack import phase_variance

if TYPE_CHECKING:
    from psfcli.products.arrays import Result

PAPER: dict[str, Any] = {
    "schema": 1,
    "wavelengths": ["9.4 nm"],
    "telescope": {
        "focal_length": "1750 mm", "aperture_diameter": "190 mm", "obscuration": 0.48, "max_field": "0.5 deg",
        "seidel": {"reference_wavelength": "9.4 nm", "W020": -30.35, "W040": 0.42, "W131": -7.6, "W222": 48.34,
                   "W220": 38.58, "W311": -5.48},
    },
    "surfaces": [
        {"marginal_height": "95 mm", "psd": {"sigma": "0.682 nm", "B": "1 mm", "C": 1.8}},
        {"marginal_height": "34.99 mm", "psd": {"sigma": "0.5 nm", "B": "1 mm", "C": 1.8}},
    ],
    "fields": ["0.3 deg"],
    "detector": {"pixel": "21 um", "pixels": 8, "oversample": 3},
    "ensquared_energy": {"half_widths": ["1 um", "10 um", "1 mm", "10 mm"]},
}  # fmt: skip
README = CONFIGS.parent / "README.md"
ENERGIES = ("ee", "ee_chief", "ee_centroid", "ee_unaberrated")
WAVES = {name: waves for name, waves in PAPER["telescope"]["seidel"].items() if name.startswith("W")}


def scene(**changes: Any) -> dict[str, Any]:
    """The paper's telescope with other values at dotted keys; __ stands for the dot."""
    made = copy.deepcopy(PAPER)
    for key, value in changes.items():
        *path, last = key.split("__")
        section: Any = made
        for step in path:
            section = section[int(step) if step.isdigit() else step]
        section[last] = value
    return made


@pytest.fixture
def run(tmp_path):
    """A function from changes of the scene to what a run gives: no warning, no nan, nothing below 0 or above 1."""

    def of(**changes: Any) -> Result:
        path = tmp_path / "x.yaml"
        path.write_text(yaml.safe_dump(scene(**changes)))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result = psfcli.run(psfcli.load(path))
        arrays = [result.psf, *([] if result.psf_over is None else [result.psf_over])]
        for values in [*arrays, *(np.asarray(result.ensquared_energy[name]) for name in ENERGIES)]:
            assert np.all(np.isfinite(values))
            assert values.min() >= 0.0
            assert values.max() <= 1.0 + max(reached.ee for reached in result.reached)
        return result

    return of


def met(result: Result) -> bool:
    """Whether the run would end with exit code 0, of standard accuracy."""
    return all(reached.pixel <= 1e-3 and reached.ee <= 1e-5 for reached in result.reached)


def apart(a: Result, b: Result) -> tuple[float, float]:
    """The largest differences of pixels, relative but for the allowance of both, and of energies."""
    excess = np.maximum(np.abs(a.psf - b.psf) - 2e-5, 0.0) / b.psf
    faint = np.minimum(a.psf, b.psf) < 1e-3 * b.psf.max()  # where no unscattered light is near
    excess[faint] = np.maximum(excess[faint], np.abs(a.psf[faint] / b.psf[faint] - 1.0))
    energy = max(float(np.max(np.abs(a.ensquared_energy[name] - b.ensquared_energy[name]))) for name in ENERGIES)
    return float(excess.max()), energy


# -- limits within what can be asked for: what is close agrees, what is closer agrees better

APPROACHES: dict[str, tuple[str, list[Any]]] = {
    # the limit last; each step at least ten times closer
    "C -> 1": ("surfaces__0__psd__C", [1.01, 1.0001, 1.000001, 1.00000001]),
    "C -> 2 from below": ("surfaces__0__psd__C", [1.99, 1.999, 1.999999, 2.0]),
    "C -> 2 from above": ("surfaces__0__psd__C", [2.01, 2.001, 2.000001, 2.0]),
    "C -> 3 from below": ("surfaces__0__psd__C", [2.99, 2.999, 2.999999, 3.0]),
    "C -> 3 from above": ("surfaces__0__psd__C", [3.01, 3.001, 3.000001, 3.0]),
    "obscuration -> 1": ("telescope__obscuration", [0.9, 0.99, 0.9999, 0.9999999999999999]),
    "wavelength": ("wavelengths", [["9.5 nm"], ["9.41 nm"], ["9.4001 nm"], ["9.4 nm"]]),
    "TIS -> 0": ("surfaces__0__psd__sigma", ["1e-2 nm", "1e-4 nm", "1e-8 nm", "0 nm"]),
    "aberration -> 0": (
        "telescope__seidel",
        [{"reference_wavelength": "9.4 nm", "W020": W} for W in (1e-1, 1e-3, 1e-6, 0.0)],
    ),
}


@pytest.mark.parametrize("name", APPROACHES)
def test_a_limit_is_reached_continuously(run, name):
    key, values = APPROACHES[name]
    *near, limit = (run(**{key: value}) for value in values)
    assert met(limit)
    assert all(met(result) for result in near)
    differences = np.array([apart(result, limit) for result in near])
    promised = 2e-3, 2e-5  # standard accuracy, for each of the two
    # what is closer is no farther apart, but for the errors allowed
    assert np.all(np.diff(differences, axis=0) <= promised)
    assert np.all(differences[-1] <= promised)
    # and what is far does differ: the comparison sees something
    assert differences[0].max() > differences[-1].max() or name == "obscuration -> 1"


def test_roughness_far_beyond_the_horizon_scatters_nothing(run):
    # B -> 0: what lies below 1/lambda is sigma^2 (B/lambda)^2 nu
    smooth = run(surfaces__0__psd__sigma="0 nm")
    energies = [apart(run(surfaces__0__psd__B=B), smooth)[1] for B in ("100 nm", "10 nm", "1 nm")]
    assert energies[2] < energies[1] < energies[0]
    assert energies[2] < 0.01


def test_slow_roughness_stays_on_the_unscattered_light(run):
    # B -> infinity: the core narrows until it is no blur
    smooth = run(surfaces__0__psd__sigma="0 nm")
    results = [run(surfaces__0__psd__B=B) for B in ("100 mm", "1 m", "10 m")]
    assert all(met(result) for result in results)
    energies = [apart(result, smooth)[1] for result in results]
    assert energies[2] < energies[1] < energies[0]
    # one-fold light beyond r is (lambda d/(B r))^(C-1); a square of 1 um at 10 m: 1e-3 of the g = 0.8
    assert energies[2] < 0.02


def test_a_surface_that_moves_into_the_image_ends_as_a_point(run):
    # h2/h1 -> 0; squares of 1 um and more
    heights = ("34.99 mm", "1 mm", "30 um", "1 nm")
    results = [run(surfaces__1__marginal_height=height) for height in heights]
    smooth = run(surfaces__1__psd__sigma="0 nm")
    assert all(met(result) for result in results)
    differences = np.array([apart(result, smooth)[1] for result in results])
    assert np.all(np.diff(differences) < 0.0)
    assert apart(results[-1], smooth)[1] <= 2e-5


def test_nearly_all_light_scattered(run):
    # TIS -> 1: with exp(-g) ever less unscattered, the image is ever more that of the halo alone
    peaks = []
    for sigma in ("2 nm", "4 nm", "8 nm"):
        result = run(surfaces__0__psd__sigma=sigma)
        assert met(result)
        assert result.psf.min() > 0.0
        peaks.append(float(result.psf.max()))
    assert peaks == sorted(peaks, reverse=True)


@pytest.mark.parametrize("nm", [1, 3, 30, 300, 600])
def test_wavelengths_from_one_to_six_hundred_nm(run, nm):
    result = run(wavelengths=[f"{nm} nm"])
    assert met(result)
    assert result.psf.min() > 0.0


@pytest.mark.parametrize("pixel", ["1 nm", "10 nm", "1 um", "1 mm", "10 mm", "100 mm", "300 mm"])
def test_pixels_of_any_width(run, pixel):
    result = run(detector__pixel=pixel)
    assert met(result)
    assert result.psf.min() > 0.0
    outside = float(result.fields["power_outside"][0])
    assert float(result.psf.sum()) + outside == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(
    "changes",
    [
        {"detector": {"pixel": "1 m", "pixels": 1, "oversample": 1}},
        {"detector": {"pixel": "100 mm", "pixels": 8, "oversample": 1}},
        {"detector": {"pixel": "1 nm", "pixels": 8, "oversample": 1}},
        {"surfaces__0__psd__B": "1 nm"},
    ],
    ids=lambda changes: str(changes),
)
def test_the_judge_agrees_at_the_limits(changes):
    made = scene(**{"ensquared_energy": {"half_widths": ["10 um", "1 mm", "300 mm"]}, **changes})
    found = kept(made, 1e-3, truth_of(made))
    assert (found.refused, found.short, found.violations) == ("", (), ())


@pytest.mark.parametrize("factor", [30.0, 300.0, 2e4])
def test_enormous_aberrations_end_and_tell_what_they_reached(run, factor):
    seidel = {"reference_wavelength": "9.4 nm", **{name: factor * waves for name, waves in WAVES.items()}}
    result = run(telescope__seidel=seidel, accuracy="draft", detector__oversample=1)
    assert result.psf.min() > 0.0
    # spots of up to a metre: exit code 3 is right where four million rays do not resolve the core
    assert factor > 300.0 or result.reached[0].pixel <= 3e-2


# the table of README, Limits: g, and C up to which each accuracy is met
STEEPEST = [
    (float(g), accuracy, float(C))
    for g, *row in re.findall(r"^  \| ([\d.]+) \| (\d+) \| (\d+) \|$", README.read_text(), re.MULTILINE)
    for accuracy, C in zip(("standard", "reference"), row, strict=True)
]


@pytest.mark.parametrize(("g", "accuracy", "C"), STEEPEST)
@pytest.mark.parametrize("B", ["0.1 mm", "1 mm", "10 mm"])
def test_spectra_as_steep_as_readme_says_are_met(g, accuracy, C, B):
    def rough(sigma: float) -> psfcli.System:
        term = f"surfaces.0.psd={{sigma: {sigma!r} nm, B: {B}, C: {C:g}}}"
        return psfcli.load(CONFIGS / "one_rough_mirror.yaml", [term], tolerance=accuracy)

    one = rough(1.0)
    system = rough(math.sqrt(g / phase_variance(one.surfaces[0], one.wavelengths[0])))
    result = psfcli.run(system)
    assert all(reached.pixel <= system.tolerance.pixel for reached in result.reached)
    assert all(reached.ee <= system.tolerance.ee for reached in result.reached)


def test_the_table_of_readme_is_found():
    assert len(STEEPEST) == 10


# -- outside what the model means, or what can be computed


@pytest.mark.parametrize("C", [1000.0, 100.0])
def test_spectra_too_steep_are_refused_with_the_reason(run, C):
    with pytest.raises(SceneError, match=f"C = {C:g} and a total phase variance of .* beyond what the mixture"):
        run(surfaces__0__psd__C=C)


def test_surfaces_too_rough_are_refused_with_the_reason(run):
    with pytest.raises(SceneError, match=r"total phase variance of 1\.\d+e\+04 is beyond"):
        run(surfaces__0__psd__sigma="100 nm")


def test_a_window_where_no_light_lands_is_refused_but_for_its_squares(run, tmp_path):
    wide = {"detector__pixel": "1 m", "detector__pixels": 64, "detector__oversample": 1}
    with pytest.raises(SceneError, match=r"the window reaches .* no light lands beyond .* --format csv would do"):
        run(**wide)
    path = tmp_path / "y.yaml"
    path.write_text(yaml.safe_dump(scene(**wide)))
    assert psfcli.write(psfcli.load(path), tmp_path / "out", formats=["csv"]).reached.ee <= 1e-5


def test_pixels_that_only_ripples_reach_are_not_negative_and_not_believed(run):
    result = run(detector__pixel="1 m")
    assert result.reached[0].pixel >= 1.0


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("detector.pixel=0.9 nm", "allowed: 1 nm..1 m"),
        ("detector.pixel=2 m", "allowed: 1 nm..1 m"),
        ("surfaces.0.psd.C=1", "allowed: above 1, up to 1000"),
        ("surfaces.0.psd.C=1001", "allowed: above 1, up to 1000"),
        ("surfaces.0.psd.B=0 mm", "allowed: 1 nm..1 km"),
        ("surfaces.1.marginal_height=0 mm", "allowed: magnitudes 1 nm..1 km"),
        ("telescope.obscuration=1", "allowed: from 0, below 1"),
        ("wavelengths=[2 mm]", "allowed: 0.1 nm..1 mm"),
        ("fields={start: 0 deg, stop: 0.5 deg, count: 10001}", "allowed: 2..10000"),
    ],
)
def test_values_beyond_the_range_are_faults_of_the_file(tmp_path, setting, told):
    path = tmp_path / "x.yaml"
    path.write_text(yaml.safe_dump(scene()))
    with pytest.raises(psfcli.ConfigError, match=told.replace("..", r"\.\.")):
        psfcli.load(path, [setting])


def test_the_command_ends_with_0_1_2_or_3(tmp_path):
    (tmp_path / "x.yaml").write_text(yaml.safe_dump(scene(detector__oversample=1)))
    settings = ["detector.pixel=100 mm", "surfaces.0.psd.C=1000", "surfaces.0.psd.C=1", "detector.pixel=1 m"]
    for code, setting in enumerate(settings):
        command = [sys.executable, "-W", "error", "-m", "psfcli", "run", "x.yaml", "--set", setting, "--overwrite"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr


def test_ten_thousand_fields(tmp_path):
    path = tmp_path / "x.yaml"
    fields = {"start": "-0.5 deg", "stop": "0.5 deg", "count": 10_000}
    path.write_text(yaml.safe_dump(scene(fields=fields, accuracy="draft", telescope__seidel={
        "reference_wavelength": "9.4 nm", "W020": -30.35, "W220": 38.58,
    }, ensquared_energy={"half_widths": ["10 um"]})))  # fmt: skip
    outcome = psfcli.write(psfcli.load(path), tmp_path / "out", formats=["csv"])
    assert outcome.reached.ee <= 1e-3
    rows = (tmp_path / "out" / "ee.csv").read_text().splitlines()[1:]
    assert len(rows) == 10_000
    ee = np.array([float(row.split(",")[5]) for row in rows])
    # -H and H are one image, turned
    np.testing.assert_array_equal(ee, ee[::-1])
