"""Images that stand for others: turned, mirrored, at another wavelength; the same as if each had been computed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from planned import apart, effect, paper, planned
from product_scenes import random_image, run_header

from psfcli import recipe
from psfcli.image.grid import Detector
from psfcli.image.symmetry import SYMMETRIES, Symmetry
from psfcli.planning.sharing import representative
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Pupil, Telescope

AROUND = [f"{{radius: 0.4 deg, azimuth: {azimuth} deg}}" for azimuth in (30, 60, 120, 150, 210, 240, 300, 330)]
AXES = ["0.4 deg", "-0.4 deg", "{radius: 0.4 deg, azimuth: 0 deg}", "{radius: 0.4 deg, azimuth: 540 deg}"]
THE_SAME = [
    "{radius: -0.4 deg, azimuth: 30 deg}",
    "{radius: 0.4 deg, azimuth: -150 deg}",
    "{radius: 0.4 deg, azimuth: 570 deg}",
]

every_symmetry = pytest.mark.parametrize("symmetry", SYMMETRIES)


@every_symmetry
def test_a_symmetry_is_undone_by_its_inverse(symmetry):
    assert symmetry.inverse.point(*symmetry.point(0.3, -2.0)) == (0.3, -2.0)
    plane = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(symmetry.inverse.plane(symmetry.plane(plane)), plane)


@every_symmetry
def test_a_symmetry_takes_points_directions_and_planes_to_the_same_place(symmetry):
    azimuth = 0.3
    x, y = symmetry.point(math.cos(azimuth), math.sin(azimuth))
    assert (math.cos(symmetry.azimuth(azimuth)), math.sin(symmetry.azimuth(azimuth))) == pytest.approx((x, y))
    # a lit pixel about the middle of a plane [y, x] goes where its coordinates go
    plane = np.zeros((5, 5))
    plane[2 - 1, 2 + 2] = 1.0
    ((row, column),) = np.argwhere(symmetry.plane(plane))
    assert (column - 2, row - 2) == symmetry.point(2.0, -1.0)


@every_symmetry
def test_a_turned_spot_keeps_its_bounds_in_order_and_its_energies(symmetry):
    image = random_image(run_header())
    turned = symmetry.image(image)
    spot = turned.spot
    assert spot.x_min < spot.x_max
    assert spot.y_min < spot.y_max
    assert math.hypot(spot.rms_x, spot.rms_y) == math.hypot(image.spot.rms_x, image.spot.rms_y)
    assert (turned.ensquared, turned.power_outside, turned.reached) == (
        image.ensquared, image.power_outside, image.reached,
    )  # fmt: skip
    assert sorted(turned.psf.ravel()) == sorted(image.psf.ravel())


def test_nothing_turned_is_a_negative_zero():
    assert all(math.copysign(1.0, value) == 1.0 for s in SYMMETRIES for value in s.point(0.0, 0.0))


@pytest.mark.parametrize(
    ("detector", "kept"),
    [
        (Detector(0.021, 4), 8),
        (Detector(0.021, 5), 8),
        (Detector(0.021, 5, 3, "pixel"), 8),
        (Detector(0.021, 4, 3, "pixel"), 2),  # x and y may be swapped, nothing else
        (Detector(0.021, 4, 1, "middle", (0.001, 0.0)), 2),  # y may be mirrored
        (Detector(0.021, 4, 1, "middle", (0.001, 0.001)), 2),
        (Detector(0.021, 4, 1, "middle", (0.001, -0.001)), 2),
        (Detector(0.021, 4, 1, "pixel", (-0.0105, -0.0105)), 2),
        (Detector(0.021, 4, 1, "pixel", (0.0105, 0.0105)), 8),  # back in the middle
        (Detector(0.021, 4, 1, "middle", (0.001, 0.002)), 1),
    ],
)
def test_a_symmetry_keeps_a_grid_only_if_every_edge_falls_on_an_edge(detector, kept):
    keeping = [symmetry for symmetry in SYMMETRIES if symmetry.keeps(detector)]
    assert len(keeping) == kept
    for symmetry in SYMMETRIES:
        x, y = detector.edges(0), detector.edges(1)
        across, along = (symmetry.x * (y if symmetry.swap else x), symmetry.y * (x if symmetry.swap else y))
        same = np.allclose(np.sort(across), x, atol=1e-12) and np.allclose(np.sort(along), y, atol=1e-12)
        assert same == (symmetry in keeping)


@pytest.mark.parametrize(
    ("changes", "computed"),
    [
        ((), 2),  # the axes, and 30 deg from them
        (("detector.centre=pixel",), 6),  # x and y swapped alone: 10 pixels have no middle one
        (("detector.pixels=11", "detector.centre=pixel"), 2),
        (("detector.offset=[0.3 pix, 0 pix]",), 7),
        (("detector.offset=[0.3 pix, -0.3 pix]",), 6),
        (("detector.offset=[0.3 pix, 0.1 pix]",), 12),
        (("telescope.sector=[0 deg, 90 deg]",), 12),
        (("telescope.seidel={reference_wavelength: 9.4 nm, W020: -30, W220: 38}",), 1),
        (("telescope.seidel={reference_wavelength: 9.4 nm, W020: -30}", "telescope.sector=[0 deg, 90 deg]"), 1),
    ],
)
def test_shared_images_are_what_each_would_be(changes, computed):
    system = paper(*changes, fields=AROUND + AXES)
    scene, images = planned(system)
    full_scene, full = planned(system, everything=True)
    assert len(full_scene.computations) == len(images) == len(full) == 12
    assert len(scene.computations) == computed
    for place, image in images.items():
        pixel, ee = apart(scene, image, full[place])
        # each keeps its promise, so both are apart by no more than two
        assert pixel <= 2.0 * scene.tolerance.pixel
        assert ee <= 2.0 * scene.tolerance.ee
        assert image.power_outside == pytest.approx(full[place].power_outside, abs=2.0 * scene.tolerance.ee)
        for name in ("centroid_x", "centroid_y", "chief_x", "chief_y", "rms_x", "rms_y"):
            mine, theirs = getattr(image.spot, name), getattr(full[place].spot, name)
            assert mine == pytest.approx(theirs, rel=1e-9, abs=1e-12)  # rounding, of microns


def test_the_comparison_sees_an_image_that_is_not_turned():
    system = paper(fields=["0.4 deg", "-0.4 deg"])
    scene, images = planned(system)
    pixel, _ = apart(scene, images[0, 0], images[0, 1])
    assert pixel > 10.0 * scene.tolerance.pixel


def test_an_azimuth_a_turn_further_or_a_negative_radius_is_the_same_image():
    scene, images = planned(paper(fields=["{radius: 0.4 deg, azimuth: 210 deg}"]))
    for field in THE_SAME:
        (again,) = planned(paper(fields=[field]))[1].values()
        np.testing.assert_array_equal(again.psf_over, images[0, 0].psf_over)
    assert len(scene.computations) == 1


def test_an_image_does_not_depend_on_the_fields_beside_it():
    alone = planned(paper(fields=["{radius: 0.4 deg, azimuth: 150 deg}"]))[1][0, 0]
    among = planned(paper(fields=AROUND))[1][0, 3]
    np.testing.assert_array_equal(alone.psf_over, among.psf_over)
    np.testing.assert_array_equal(alone.ensquared.ee_chief, among.ensquared.ee_chief)
    assert alone.spot == among.spot


def test_without_pixels_the_grid_does_not_matter():
    system = paper("detector.offset=[0.3 pix, 0.1 pix]", fields=AROUND + AXES)
    scene, images = planned(system, with_cube=False)
    _, full = planned(system, with_cube=False, everything=True)
    assert len(scene.computations) == 2
    for place, image in images.items():
        assert apart(scene, image, full[place])[1] <= 2.0 * scene.tolerance.ee


def test_wavelengths_at_which_nothing_scatters_share_their_images():
    smooth = [f"surfaces.{i}.psd=[]" for i in (0, 1)]
    system = paper(*smooth, "wavelengths=[9.4 nm, 20 nm, 30 nm]", fields=["0 deg", "0.4 deg"])
    scene, images = planned(system)
    assert len(scene.computations) == 2
    assert sorted(images) == [(w, f) for w in range(3) for f in range(2)]
    assert not effect(scene, "wavelength 20 nm").modelled
    assert "the images of 9.4 nm" in effect(scene, "wavelength 20 nm").because
    np.testing.assert_array_equal(images[2, 1].psf, images[0, 1].psf)
    # with scatter every wavelength has its own
    assert len(recipe.plan(paper("wavelengths=[9.4 nm, 20 nm]")).computations) == 2


def test_the_plan_names_the_field_whose_image_another_has():
    scene = recipe.plan(paper(fields=["0.4 deg", "-0.4 deg", "{radius: 0.4 deg, azimuth: 30 deg}"]))
    assert [effect(scene, f"field {name}").modelled for name in ("0.4 deg", "-0.4 deg")] == [True, False]
    mirrored = effect(scene, "field -0.4 deg")
    assert (mirrored.ee, mirrored.pixel, mirrored.saves) == (0.0, 0.0, "its image")
    assert mirrored.because == "the image of 0.4 deg, turned or mirrored"
    assert effect(scene, "field 0.4 deg at azimuth 30 deg").modelled


def test_what_is_computed_is_the_nearest_field_to_plus_y():
    telescope = Telescope(0.05, Pupil(0.4), SeidelTable(W131=1e-5), 0.01, 1750.0)
    for azimuth in np.linspace(-7.0, 7.0, 57):
        field, symmetry = representative(telescope, Field(-0.004, azimuth), SYMMETRIES)
        assert field.radius == 0.004
        assert math.pi / 4.0 - 1e-9 <= field.azimuth <= math.pi / 2.0
        turned = symmetry.azimuth(field.azimuth)
        assert math.remainder(turned - azimuth - math.pi, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-11)
    assert representative(telescope, Field(0.004, 0.3), [Symmetry()])[1] == Symmetry()


@pytest.mark.parametrize("together", [1, 3])
def test_two_jobs_give_the_images_of_one(together):
    from dataclasses import replace

    scene = recipe.plan(paper(fields=AROUND + AXES, accuracy="draft"))
    more = replace(scene, resources=replace(scene.resources, jobs=2, together=together))
    one, two = (list(recipe.images(each)) for each in (scene, more))
    assert [place[:2] for place in one] == [place[:2] for place in two]
    for (_, _, mine), (_, _, theirs) in zip(one, two, strict=True):
        np.testing.assert_array_equal(mine.psf_over, theirs.psf_over)
        np.testing.assert_array_equal(mine.ensquared.ee, theirs.ensquared.ee)
        assert mine.reached == theirs.reached
