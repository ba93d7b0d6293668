"""The composite image of Eq. 44, from the system file to pixels and boxes, against the judge, samples and itself."""

import functools
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from photutils.profiles import EnsquaredCurveOfGrowth
from truth import box_energy, outside_fraction, pixel_energy
from truth.geometry import spot_moments
from truth.montecarlo import sampled_boxes, sampled_pixels
from truth.scenes import judged, mm, pixel_edges, window

import psfcli
from psfcli.tolerance import PRESETS

PAPER = {
    "schema": 1,
    "wavelengths": ["9.4 nm"],
    "telescope": {
        "focal_length": "1750 mm",
        "aperture_diameter": "190 mm",
        "obscuration": 0.48,
        "max_field": "0.5 deg",
        "seidel": {
            "reference_wavelength": "9.4 nm", "W020": -30.35, "W040": 0.42, "W131": -7.6, "W222": 48.34,
            "W220": 38.58, "W311": -5.48,
        },
    },
    "surfaces": [
        {"marginal_height": height, "psd": {"sigma": "0.6820358828624745 nm", "B": "1 mm", "C": 1.8}}
        for height in ("95 mm", "34.9885 mm")
    ],
    "fields": ["0 deg", "0.5 deg", {"radius": "0.4 deg", "azimuth": "30 deg"}],
    "detector": {"pixel": "21 um", "pixels": 40, "oversample": 3},
    "ensquared_energy": {"half_widths": ["4 um", "42 um", "5 mm"]},
}  # fmt: skip

SLOW_OPTICS = {
    "image_distance": "200 mm", "exit_pupil_radius": "20 mm", "obscuration": 0.2, "max_field": "5 mm",
    "seidel": {"reference_wavelength": "500 nm", "W020": 3.0, "W040": -2.0, "W131": 5.0, "W222": -4.0, "W311": 2.0},
}  # fmt: skip

SCENES = {
    "the paper's telescope": PAPER,
    "a sector, a negative field, a pixel in the centre and an offset": {
        **PAPER,
        "telescope": {**PAPER["telescope"], "sector": ["60 deg", "120 deg"]},
        "fields": ["-0.3 deg"],
        "detector": {"pixel": "10 um", "pixels": 33, "centre": "pixel", "offset": ["0.3 pix", "-0.013 mm"]},
    },
    "finite conjugates, two terms, tilted mirrors": {
        "schema": 1,
        "wavelengths": ["500 nm"],
        "telescope": SLOW_OPTICS,
        "surfaces": [
            {"marginal_height": "20 mm", "incidence": "6 deg", "psd": {"sigma": "20 nm", "B": "3 mm", "C": 2.0}},
            {
                "marginal_height": "-8 mm",
                "psd": [{"sigma": "15 nm", "B": "1 mm", "C": 4.0}, {"sigma": "4 nm", "B": "0.1 mm", "C": 2}],
            },
        ],
        "fields": ["5 mm", {"radius": "2 mm", "azimuth": "200 deg"}],
        "detector": {"pixel": "30 um", "pixels": 24, "oversample": 2, "centre": "pixel"},
        "ensquared_energy": {"half_widths": ["15 um", "75 um", "5 mm"]},
    },
    "a lens whose faces bring their own aberrations": {
        "schema": 1,
        "wavelengths": ["600 nm"],
        "telescope": {
            "focal_length": "100 mm", "aperture_diameter": "20 mm", "max_field": "3 deg",
            "seidel": {"reference_wavelength": "600 nm", "W020": -6.0},
        },
        "surfaces": [
            {
                "kind": "refracting", "index": [1.0, 1.5], "marginal_height": "10 mm",
                "seidel": {"W040": 3.5, "W131": 3.7, "W220": 1.3},
                "psd": {"sigma": "60 nm", "B": "0.5 mm", "C": 2.0},
            },
            {
                "kind": "refracting", "index": [1.5, 1.0], "marginal_height": "9.6 mm",
                "seidel": {"reference_wavelength": "300 nm", "W040": 2.0, "W131": -4.8},
                "psd": {"sigma": "60 nm", "B": "0.5 mm", "C": 2.0},
            },
        ],
        "fields": ["2 deg"],
        "detector": {"pixel": "30 um", "pixels": 30},
        "ensquared_energy": {"half_widths": ["15 um", "75 um", "3 mm"]},
    },
    "a detector in glass, behind one rough face": {
        "schema": 1,
        "wavelengths": ["600 nm"],
        "telescope": {**SLOW_OPTICS, "image_distance": "300 mm"},
        "surfaces": [
            {
                "kind": "refracting", "index": [1.0, 1.6], "marginal_height": "20 mm",
                "psd": {"sigma": "200 nm", "B": "0.02 mm", "C": 2.0},  # B = 33 wavelengths: the horizon counts
            }
        ],
        "fields": ["3 mm"],
        "detector": {"pixel": "1 mm", "pixels": 40, "oversample": 2},
        "ensquared_energy": {"half_widths": ["20 um", "1 mm", "35 mm"]},
    },
}  # fmt: skip

# (row, column) in shares of the window: near the middle, where the light is, and out to the corners
PLACES = [(0.5, 0.5), (0.55, 0.45), (0.0, 0.0), (0.999, 0.3)]
IMAGES = [(name, field) for name, scene in SCENES.items() for field in range(len(scene["fields"]))]

every_image = pytest.mark.parametrize(("name", "field"), IMAGES)
every_accuracy = pytest.mark.parametrize("accuracy", PRESETS)


def made(scene, accuracy, *overrides):
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "scene.yaml"
        path.write_text(yaml.safe_dump(scene))
        return psfcli.run(psfcli.load(path, overrides, None, accuracy))


@functools.cache
def result(name, accuracy):
    return made(SCENES[name], accuracy)


def rows_of(product, field):
    """The boxes of one field, in the order of the fields given."""
    table, given = product.ensquared_energy, product.fields[field]
    return table[(table["field"] == given["field"]) & (table["azimuth_deg"] == given["azimuth"])]


@functools.cache
def judged_pixels(name, field):
    """(row, column, fine) and the judge's energy of some pixels."""
    scene = SCENES[name]
    system, detector = judged(scene, field), scene["detector"]
    n, m = detector["pixels"], detector.get("oversample", 1)
    places = [(int(v * n), int(u * n), False) for v, u in PLACES]
    if m > 1:
        places += [(n * m // 2, n * m // 2 - 1, True)]
    exact = []
    for row, column, fine in places:
        x, y = (pixel_edges(detector, i, axis, fine=fine) for i, axis in ((column, 0), (row, 1)))
        exact.append(pixel_energy(system, *x, *y))
    return places, np.array(exact)


@every_accuracy
@every_image
def test_pixels_are_within_the_accuracy_asked_for(name, field, accuracy):
    asked, product = PRESETS[accuracy], result(name, accuracy)
    places, exact = judged_pixels(name, field)
    cubes = {False: product.psf[0, field], True: None if product.psf_over is None else product.psf_over[0, field]}
    got = np.array([cubes[fine][row, column] for row, column, fine in places])
    # unscattered light may be off by ee; the spot lies within the pixels about the middle
    near = [0.4 < row / cubes[fine].shape[0] < 0.65 for row, _, fine in places]
    judge = 1e-9 * exact + 1e-10
    assert np.all(np.abs(got - exact) <= asked.pixel * exact + asked.ee * np.array(near) + judge * (asked.pixel < 1e-5))


def judged_boxes(name, field):
    """Some of the judge's ensquared energies by (column, box)."""
    system, half_widths = judged(SCENES[name], field), [mm(h) for h in half_widths_of(name)]
    spot = spot_moments(system)
    exact = {("ee", box): box_energy(system, half_width) for box, half_width in enumerate(half_widths)}
    exact["ee_chief", 1] = box_energy(system, half_widths[1], (spot["chief_x"], spot["chief_y"]))
    exact["ee_centroid", 0] = box_energy(system, half_widths[0], (spot["centroid_x"], spot["centroid_y"]))
    exact["ee_unaberrated", 0] = box_energy(system.but(seidel={}), half_widths[0])
    return exact


def half_widths_of(name):
    return SCENES[name]["ensquared_energy"]["half_widths"]


@pytest.mark.parametrize(("name", "field"), [image for image in IMAGES if image != ("the paper's telescope", 0)])
def test_ensquared_energies_about_every_centre_are_within_the_accuracy_asked_for(name, field):
    exact = judged_boxes(name, field)
    for accuracy, asked in PRESETS.items():
        rows = rows_of(result(name, accuracy), field)
        got = [rows[column][box] for column, box in exact]
        np.testing.assert_allclose(got, [*exact.values()], rtol=0.0, atol=asked.ee + 1e-9)  # the judge's own 1e-9


@every_image
def test_light_outside_the_window_is_what_the_window_lacks(name, field):
    outside = outside_fraction(judged(SCENES[name], field), *window(SCENES[name]["detector"]))
    for accuracy, asked in PRESETS.items():
        product = result(name, accuracy)
        told = float(product.fields["power_outside"][field])
        assert told == pytest.approx(outside, abs=asked.ee + 1e-9)  # the judge's own 1e-9
        assert product.psf[0, field].sum() + told == pytest.approx(1.0, abs=2.0 * asked.ee)  # each within ee


@every_image
def test_errors_are_told_and_are_within_what_was_asked(name, field):
    for accuracy, asked in PRESETS.items():
        reached = result(name, accuracy).reached[field]
        assert reached.pixel <= asked.pixel
        assert reached.ee <= asked.ee


def test_sub_pixels_add_up_to_pixels():
    product = result("the paper's telescope", "draft")
    blocks = product.psf_over[0].reshape(3, 40, 3, 40, 3).sum(axis=(2, 4))
    np.testing.assert_allclose(blocks, product.psf[0], rtol=1e-14)  # nine terms' rounding


def test_a_moved_grid_does_not_move_the_boxes():
    moved = {**PAPER, "detector": {**PAPER["detector"], "oversample": 1, "offset": ["1 pix", "-2 pix"]}}
    product, still = made(moved, "standard"), result("the paper's telescope", "standard")
    # the window moves under the image: what was in column 1, row 0 is now in column 0, row 2
    np.testing.assert_allclose(product.psf[..., 2:, :-1], still.psf[..., :-2, 1:], rtol=2e-3, atol=2e-5)  # `standard`
    for column in ("ee", "ee_chief", "ee_centroid"):
        np.testing.assert_allclose(product.ensquared_energy[column], still.ensquared_energy[column], atol=2e-5)


@pytest.mark.parametrize("centre", ["middle", "pixel"])
def test_boxes_of_whole_pixels_are_what_photutils_sums_in_the_cube(centre):
    scene = {**PAPER, "detector": {"pixel": "21 um", "pixels": 24, "centre": centre}, "fields": ["0.5 deg"]}
    del scene["ensquared_energy"]
    product = made(scene, "reference")
    sizes = np.arange(1.0, 12.0) - (0.5 if centre == "pixel" else 0.0)
    middle = 11.5 if centre == "middle" else 12.0
    grown = EnsquaredCurveOfGrowth(np.ascontiguousarray(product.psf[0, 0]), (middle, middle), sizes).profile
    rows = rows_of(product, 0)
    width = rows["width_px"].value
    ee = [rows["ee"][np.argmin(np.abs(width - 2.0 * size))] for size in sizes]
    np.testing.assert_allclose(grown, ee, atol=3e-8)  # `reference`: 1e-8 for each, and 1e-6 of faint pixels


def test_sampled_rays_land_as_often_as_the_image_says():
    name, field = "finite conjugates, two terms, tilted mirrors", 0
    system, product = judged(SCENES[name], field), result(name, "standard")
    detector = SCENES[name]["detector"]
    edges = np.array([pixel_edges(detector, i, 0)[0] for i in range(25)])
    share, error = sampled_pixels(system, edges, edges, 1 << 19, seed=7)
    pulls = ((share - product.psf[0, field]) / error)[share > 2e-5]  # ten rays and more
    assert pulls.size > 30
    assert np.abs(pulls).max() < 4.5  # 4 standard errors for one, a little more for the worst of hundreds
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=4.0 / math.sqrt(2.0 * pulls.size))
    half_widths = np.array([0.015, 0.075, 5.0])
    share, error = sampled_boxes(system, half_widths, 1 << 18, seed=8)
    assert np.all(np.abs(share - rows_of(product, field)["ee"]) < 4.0 * error)


def test_what_lies_far_beyond_the_horizon_of_a_surface_near_the_image_is_right_or_said_to_be_wrong():
    # a face a fraction of a millimetre before the detector: its light ends at d = 0.18 mm, the window at 4 mm
    near = {**PAPER["surfaces"][1], "marginal_height": "0.01 mm"}
    scene = {
        **PAPER,
        "telescope": {k: v for k, v in PAPER["telescope"].items() if k != "seidel"},
        "surfaces": [PAPER["surfaces"][0], near],
        "fields": ["0 deg"],
        "detector": {"pixel": "1 mm", "pixels": 8},
        "ensquared_energy": {"half_widths": ["1 mm"]},
    }
    product = made(scene, "reference")
    x0, x1 = pixel_edges(scene["detector"], 7, 0)
    exact = pixel_energy(judged(scene), x0, x1, x0, x1)
    error = abs(product.psf[0, 0, 7, 7] / exact - 1.0)
    assert product.psf.sum() <= 1.0
    assert error < 3.0 * max(product.reached[0].pixel, PRESETS["reference"].pixel)
