"""The whole pipeline at its limits: reached continuously, judged where they can be, refused with a reason elsewhere."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from limit_scenes import (
    CONTINUOUS,
    COUNT,
    DRAFT,
    ENERGIES,
    FACTORS,
    FAST,
    INTO_THE_IMAGE,
    JUDGED,
    MANY_FIELDS,
    REFUSED,
    SLOW,
    Approach,
    apart,
    enormous,
    loaded,
    scene,
)
from planned import CONFIGS
from promise import kept, truth_of

import psfcli
from psfcli.recipe import SceneError
from psfcli.surface.harvey_shack import phase_variance

if TYPE_CHECKING:
    from psfcli.products.arrays import Result

README = CONFIGS.parent / "README.md"


@pytest.fixture
def run():
    """A function from changes of the scene to what a run gives: no warning, no nan, nothing below 0 or above 1."""

    def of(**changes: Any) -> Result:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result = psfcli.run(loaded(**changes))
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


def approached(run, approach: Approach) -> tuple[list[Result], Result]:
    """What the runs near a limit give, and the run at the limit."""
    return [run(**changes) for changes in approach.near], run(**approach.limit)


# -- limits within what can be asked for: what is close agrees, what is closer agrees better


@pytest.mark.parametrize("name", CONTINUOUS)
def test_a_limit_is_reached_continuously(run, name):
    near, limit = approached(run, CONTINUOUS[name])
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
    results, smooth = approached(run, FAST)
    energies = [apart(result, smooth)[1] for result in results]
    assert energies[2] < energies[1] < energies[0]
    assert energies[2] < 0.01


def test_slow_roughness_stays_on_the_unscattered_light(run):
    results, smooth = approached(run, SLOW)
    assert all(met(result) for result in results)
    energies = [apart(result, smooth)[1] for result in results]
    assert energies[2] < energies[1] < energies[0]
    # one-fold light beyond r is (lambda d/(B r))^(C-1); a square of 1 um at 10 m: 1e-3 of the g = 0.8
    assert energies[2] < 0.02


def test_a_surface_that_moves_into_the_image_ends_as_a_point(run):
    results, smooth = approached(run, INTO_THE_IMAGE)  # squares of 1 um and more
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


@pytest.mark.parametrize("name", JUDGED)
def test_the_judge_agrees_at_the_limits(name):
    made = scene(**JUDGED[name])
    found = kept(made, 1e-3, truth_of(made))
    assert (found.refused, found.short, found.violations) == ("", (), ())


@pytest.mark.parametrize("factor", FACTORS)
def test_enormous_aberrations_end_and_tell_what_they_reached(run, factor):
    result = run(**enormous(factor), **DRAFT)
    assert result.psf.min() > 0.0
    # spots of up to a metre: exit code 3 is right where six million rays do not resolve the core
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


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_computed_is_refused_with_the_reason(run, name):
    changes, reason = REFUSED[name]
    with pytest.raises(SceneError, match=reason):
        run(**changes)


def test_a_window_where_no_light_lands_has_squares_all_the_same(tmp_path):
    changes, _ = REFUSED["64 x 64 pixels of 1 m"]
    assert psfcli.write(loaded(**changes), tmp_path / "out", formats=["csv"]).reached.ee <= 1e-5


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
    outcome = psfcli.write(loaded(**MANY_FIELDS), tmp_path / "out", formats=["csv"])
    assert outcome.reached.ee <= 1e-3
    rows = (tmp_path / "out" / "ee.csv").read_text().splitlines()[1:]
    assert len(rows) == COUNT
    ee = np.array([float(row.split(",")[5]) for row in rows])
    # -H and H are one image, turned
    np.testing.assert_array_equal(ee, ee[::-1])
