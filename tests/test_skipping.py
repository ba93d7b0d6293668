"""What a scene does without: each rule bites where it may, says so in the plan, and its bound is one."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from planned import apart, effect, paper, planned

from psfcli import recipe
from psfcli.image.ensquared import unaberrated_energy
from psfcli.image.scatter import scatter_terms, scattered_light
from psfcli.planning.plan import SHARE
from psfcli.planning.smoothness import energy_change, pixel_change, smooth_enough, without
from psfcli.surface.autocovariance import decorrelation
from psfcli.surface.mixture import MixtureError
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Pupil, Telescope
from psfcli.tolerance import Tolerance

TELESCOPE = Telescope(0.05, Pupil(), SeidelTable(), 0.01, 1000.0)
# finer than any change looked at
FINE = Tolerance(1e-9, 1e-11)

VISIBLE = ("wavelengths=[500 nm]", "surfaces.0.psd={sigma: 20 nm, B: 1 mm, C: 1.8}")


def drawn(seed):
    """Surfaces, the place of a term smoother than they are, a wavelength and a distance [mm]."""
    draw = np.random.default_rng(seed)
    wavelength = 10.0 ** draw.uniform(-6.0, -3.0)

    def term(log_low, log_high):
        a = 10.0 ** draw.uniform(log_low, log_high)
        B = max(10.0 ** draw.uniform(-2.0, 1.5), 10.0 * wavelength)
        return KCorrelation(math.sqrt(a) * wavelength / (4.0 * math.pi), B, draw.uniform(1.1, 6.0))

    heights = 50.0 * 10.0 ** np.array([0.0, *draw.uniform(-1.5, 0.0, 2)])
    surfaces = [Surface(str(i), height, (term(-3.0, 0.7),)) for i, height in enumerate(heights)]
    smooth = term(-9.0, -3.0)
    if seed % 2:  # a surface of its own
        surfaces[2] = Surface("smooth", heights[2], (smooth,))
        return surfaces, (2, 0), wavelength, 10.0 ** draw.uniform(-1.0, 2.0)
    surfaces[0] = Surface("rough", heights[0], (*surfaces[0].psd, smooth))
    return surfaces, (0, 1), wavelength, 10.0 ** draw.uniform(-1.0, 2.0)


@pytest.mark.parametrize("seed", range(24))
def test_no_pixel_and_no_square_changes_by_more_than_the_bound_of_a_term(seed):
    surfaces, place, wavelength, distance = drawn(seed)
    pixel = pixel_change(surfaces, [place], TELESCOPE, wavelength, distance)
    try:
        whole, part = (
            scattered_light(some, TELESCOPE, wavelength, max(distance, 30.0), FINE)
            for some in (surfaces, without(surfaces, [place]))
        )
    except MixtureError:
        assert pixel == math.inf
        return
    radius = np.geomspace(1e-6, distance, 400)
    S, S_part = whole.mixture.density(radius), part.mixture.density(radius)
    true = np.max(np.abs(S - S_part) / S)
    assert true <= pixel + 2.0 * FINE.pixel
    # not a bound that everything keeps: without the clip it is the change but for the coarse step
    assert pixel == math.inf or pixel < 2.0 * true + 1e-7
    squares = np.geomspace(1e-5, 21.0, 200)
    moved = np.max(np.abs(unaberrated_energy(whole, squares) - unaberrated_energy(part, squares)))
    assert moved <= energy_change(surfaces, [place], wavelength) + 2.0 * FINE.ee


@pytest.mark.parametrize("nu", [1e-3, 0.05, 0.4, 1.0, 3.0, 20.0])
@pytest.mark.parametrize("waves", [0.01, 0.1, 1.0, 10.0, 1e3, 1e6])  # B in wavelengths
def test_the_clip_acts_at_separations_below_a_quarter_of_the_wavelength_alone(nu, waves):
    # the exponent of a term is a [rho - 1] + a (1 + (B/lambda)^2)^-nu
    beyond = math.exp(-nu * math.log1p(waves**2))
    assert decorrelation(np.array([2.0 * math.pi * 0.25 / waves]), nu)[0] >= beyond


def test_a_smooth_enough_term_falls_out_and_its_bound_is_kept_everywhere():
    system = paper(*VISIBLE, "surfaces.1.psd={sigma: 0.005 nm, B: 10 mm, C: 1.8}")
    scene, images = planned(system)
    fine = paper(*VISIBLE, "surfaces.1.psd={sigma: 0.005 nm, B: 10 mm, C: 1.8}", accuracy=Tolerance(1e-7, 1e-9))
    fine_scene, fine_full = planned(fine, everything=True)
    skipped = effect(scene, "scatter of secondary")
    assert not skipped.modelled
    assert 0.0 < skipped.pixel <= SHARE * system.tolerance.pixel
    assert 0.0 < skipped.ee <= SHARE * system.tolerance.ee
    assert skipped.because == "smooth enough in every square and pixel asked for"
    assert scene.modelled_surfaces[0][1].psd == ()
    # what is left out is among the errors told, and they hold
    assert images[0, 0].reached.ee >= scene.left_out[0].ee == skipped.ee
    assert images[0, 0].reached.pixel >= scene.left_out[0].pixel == skipped.pixel
    pixel, ee = apart(scene, images[0, 0], fine_full[0, 0])
    # what is told is an estimate, to be trusted to a factor of three
    assert 0.0 < pixel <= 3.0 * images[0, 0].reached.pixel
    assert ee <= 3.0 * images[0, 0].reached.ee
    # the rule alone: a finer calculation with and without it
    ((_, _, bare),) = recipe.images(replace(fine_scene, modelled_surfaces=scene.modelled_surfaces))
    pixel, ee = apart(fine_scene, bare, fine_full[0, 0])
    assert pixel <= scene.left_out[0].pixel + 2.0 * fine.tolerance.pixel
    assert ee <= scene.left_out[0].ee + 2.0 * fine.tolerance.ee
    assert effect(fine_scene, "scatter of secondary").modelled


def test_a_wing_that_is_brightest_far_out_stays_however_little_light_it_holds():
    # a smooth spectrum of great breadth beside a steep one: a millionth of the light, and all there is in the corners
    wing = "surfaces.1.psd={sigma: 0.01 nm, B: 0.2 mm, C: 2}"
    steep = ("wavelengths=[500 nm]", "surfaces.0.psd={sigma: 20 nm, B: 1 m, C: 6}", wing)
    system = paper(*steep)
    scene = recipe.plan(system)
    kept = effect(scene, "scatter of secondary")
    assert kept.modelled
    assert kept.ee <= SHARE * system.tolerance.ee
    assert kept.pixel > 0.5
    assert kept.because == "lights pixels that little else lights"
    # for squares alone it falls out, and they do not change by more than its bound
    bare, images = planned(system, with_cube=False)
    assert not effect(bare, "scatter of secondary").modelled
    _, full = planned(system, with_cube=False, everything=True)
    assert apart(bare, images[0, 0], full[0, 0])[1] <= 2.0 * system.tolerance.ee


def test_light_below_the_floor_falls_out_of_pixels_too():
    smooth = ["surfaces.0.psd={sigma: 1e-16 nm, B: 1 mm, C: 2}", "surfaces.1.psd=[]"]
    scene, images = planned(paper(*smooth, "wavelengths=[500 nm]"))
    assert not effect(scene, "scatter of primary").modelled
    assert images[0, 0].psf.min() == 0.0
    # the same at a thousandth of the wavelength and a trillion times rougher is seen in every pixel
    rough = ["surfaces.0.psd={sigma: 1e-4 nm, B: 1 mm, C: 2}", "surfaces.1.psd=[]"]
    assert effect(recipe.plan(paper(*rough, "wavelengths=[0.5 nm]")), "scatter of primary").modelled


def test_many_small_terms_do_not_fall_out_together():
    # each would, alone
    terms = ", ".join(f"{{sigma: 0.02 nm, B: {B} mm, C: 2}}" for B in (1.0, 1.1, 1.2, 1.3, 1.4))
    system = paper(*VISIBLE, f"surfaces.1.psd=[{terms}]")
    smooth = smooth_enough(
        system.surfaces, system.telescope, system.wavelengths[0], 0.0, Tolerance(0.0, SHARE * system.tolerance.ee)
    )
    small = [term for term in smooth.terms if term.place[0] == 1]
    assert all(term.change.ee <= SHARE * system.tolerance.ee for term in small)
    assert 0 < sum(term.skipped for term in small) < len(small)
    assert smooth.left_out.ee <= SHARE * system.tolerance.ee


def test_perfectly_smooth_surfaces_cost_nothing_and_say_so():
    scene = recipe.plan(paper("surfaces.1.psd=[]"))
    smooth = effect(scene, "scatter of secondary")
    assert (smooth.modelled, smooth.ee, smooth.pixel, smooth.because) == (False, 0.0, 0.0, "perfectly smooth")
    assert effect(scene, "multiple scatter").modelled
    scene = recipe.plan(paper("surfaces.0.psd=[]", "surfaces.1.psd=[]"))
    assert not effect(scene, "multiple scatter").modelled


def test_equal_terms_are_one_and_the_image_is_the_same():
    psd = "{sigma: 0.5 nm, B: 1 mm, C: 1.8}"
    twice = "{sigma: 0.70710678118654752 nm, B: 1 mm, C: 1.8}"
    split, joined = (paper(f"surfaces.0.psd={some}", "surfaces.1.psd=[]") for some in (f"[{psd}, {psd}]", twice))
    assert len(scatter_terms(split.surfaces, split.telescope, split.wavelengths[0])) == 1
    scene, images = planned(split)
    shared = effect(scene, "scatter of primary, psd[1]")
    assert (shared.modelled, shared.ee, shared.pixel) == (False, 0.0, 0.0)
    assert shared.because == "same order and same lambda d/B as primary, psd[0]: variances add"
    # one spectrum of twice the variance: the same to rounding
    np.testing.assert_allclose(images[0, 0].psf_over, planned(joined)[1][0, 0].psf_over, rtol=1e-11)


def test_surfaces_of_one_distance_and_one_spectrum_share_their_term():
    system = paper("surfaces.1.marginal_height=-95 mm")
    (term,) = scatter_terms(system.surfaces, system.telescope, system.wavelengths[0])
    first, second = (scatter_terms([s], system.telescope, system.wavelengths[0])[0] for s in system.surfaces)
    assert term.phase_variance == first.phase_variance + second.phase_variance
    assert not effect(recipe.plan(system), "scatter of secondary").modelled


def test_unaberrated_systems_trace_nothing():
    system = paper("telescope.seidel={reference_wavelength: 9.4 nm}", fields=["0 deg", "0.3 deg"])
    scene, images = planned(system)
    assert effect(scene, "rays").because == "no aberration matters: one ray is all"
    assert len(scene.computations) == 1
    from psfcli.image.geometric import geometrical_images, moment_rays
    from psfcli.image.patches import patches_apart

    assert moment_rays(scene.modelled_telescope, [scene.fields[1]])[0].x.size == 1
    (point,) = geometrical_images(scene.modelled_telescope, [scene.fields[1]])
    assert [rays.x.size for rays in patches_apart(point, 1e-3)] == [1]
    np.testing.assert_array_equal(images[0, 0].psf, images[0, 1].psf)


ODD = ("detector.pixels=11", "detector.centre=pixel")
TINY = "telescope.seidel={reference_wavelength: 9.4 nm, W040: 3e-5, W131: 4e-5, W311: 2e-5}"
LARGE = "ensquared_energy={half_widths: [10.5 um, 1 mm]}"


def test_aberrations_fall_out_where_no_edge_and_no_slope_notices_them():
    system = paper(*ODD, TINY, LARGE)
    scene, images = planned(system)
    for name in ("W040", "W131", "W311"):
        skipped = effect(scene, f"aberration {name}")
        assert not skipped.modelled
        assert 0.0 < skipped.pixel <= SHARE * system.tolerance.pixel
        assert 0.0 < skipped.ee <= SHARE * system.tolerance.ee
    assert effect(scene, "aberration W020").because == "zero"
    assert scene.modelled_telescope.seidel == SeidelTable()
    fine = paper(*ODD, TINY, LARGE, accuracy=Tolerance(1e-7, 1e-9))
    fine_scene, full = planned(fine, everything=True)
    ((_, _, bare),) = recipe.images(replace(fine_scene, modelled_telescope=scene.modelled_telescope))
    pixel, ee = apart(fine_scene, bare, full[0, 0])
    assert pixel <= scene.left_out[0].pixel + 2.0 * fine.tolerance.pixel
    assert ee <= scene.left_out[0].ee + 2.0 * fine.tolerance.ee
    pixel, ee = apart(scene, images[0, 0], full[0, 0])
    # what is told is an estimate, to be trusted to a factor of three
    assert pixel <= 3.0 * images[0, 0].reached.pixel
    assert ee <= 3.0 * images[0, 0].reached.ee
    # the spot told is that of the telescope as it is
    assert images[0, 0].spot == full[0, 0].spot
    assert images[0, 0].spot.chief_y != 0.0


@pytest.mark.parametrize(
    "change",
    [
        "detector.centre=middle",  # of 10 pixels and 3 sub-pixels each: light on edges
        "ensquared_energy={half_widths: [0.05 nm]}",  # a square smaller than the spot
        "detector.offset=[3.5 um, 0 um]",  # the edge of a sub-pixel
        "telescope.seidel={reference_wavelength: 9.4 nm, W040: 1}",  # too far for the slope of the scatter
    ],
)
def test_aberrations_stay_where_an_edge_or_a_slope_notices_them(change):
    pixels = "detector.pixels=10" if "middle" in change else "detector.pixels=11"
    system = paper(*ODD, TINY, LARGE, change, pixels)
    scene = recipe.plan(system)
    assert effect(scene, "aberration W040").modelled
    assert scene.modelled_telescope == system.telescope


@pytest.mark.parametrize("seed", range(8))
def test_displaced_light_changes_no_more_than_its_bound(seed):
    """A shifted image of one rough surface against the bound of the shift, in pixels and squares."""
    from psfcli.image.grid import Detector
    from psfcli.planning.displacement import sensitivity

    draw = np.random.default_rng(seed)
    wavelength, C, B = 1e-5, draw.uniform(1.2, 6.0), 10.0 ** draw.uniform(-1.0, 1.0)
    surfaces = [Surface("one", 50.0, (KCorrelation(draw.uniform(0.1, 1.5) * wavelength / 12.0, B, C),))]
    halo = scattered_light(surfaces, TELESCOPE, wavelength, 30.0, FINE).mixture
    width = wavelength * 1000.0 / B
    shift = 10.0 ** draw.uniform(-4.0, -1.0) * width
    bound = sensitivity({wavelength: surfaces}, TELESCOPE, 0.0, Detector(0.1, 100), 1.0).change(shift)
    r = np.geomspace(1e-3 * width, 7.0, 300)
    relative = np.max(np.abs(halo.density(r + shift) / halo.density(r) - 1.0))
    assert relative <= bound.pixel
    from psfcli.image.blur import normal_probability

    s, half = np.sqrt(halo.variance), np.geomspace(1e-2 * width, 7.0, 60)[:, None]
    centred = normal_probability(-half / s, half / s)
    moved = normal_probability((shift - half) / s, (shift + half) / s)
    assert np.max(np.abs(((moved - centred) * centred) @ halo.weight)) <= bound.ee


def test_only_products_asked_for_are_computed():
    system = paper()
    squares, images = planned(system, with_cube=False)
    assert images[0, 0].psf is images[0, 0].psf_over is images[0, 0].power_outside is None
    for name in ("cube", "oversampling", "light outside the window"):
        assert not effect(squares, name).modelled
        assert effect(squares, name).because == "no product asked for holds it"
    pixels, images = planned(system, with_boxes=False)
    assert images[0, 0].ensquared.ee.size == 0
    assert not effect(pixels, "ensquared energy").modelled
    assert pixels.reach < squares.reach
    whole, both = planned(system)
    assert whole.reach == squares.reach
    # a smaller reach, other wide Gaussians: each within its promise, here far from the unscattered light
    corner = images[0, 0].psf_over[0, 0] / both[0, 0].psf_over[0, 0]
    assert corner == pytest.approx(1.0, abs=2.0 * system.tolerance.pixel)
    assert images[0, 0].power_outside == pytest.approx(both[0, 0].power_outside, abs=2.0 * system.tolerance.ee)


def test_nothing_is_skipped_without_a_bound_and_every_bound_fits_its_share():
    scenes = [
        paper(), paper(*VISIBLE, "surfaces.1.psd={sigma: 0.005 nm, B: 10 mm, C: 1.8}"), paper(*ODD, TINY, LARGE),
        paper("surfaces.0.psd=[]", "surfaces.1.psd=[]", fields=["0.3 deg", "-0.3 deg"]),
    ]  # fmt: skip
    for system in scenes:
        for scene in (recipe.plan(system), recipe.plan(system, with_cube=False)):
            for each in scene.effects:
                if not each.modelled:
                    assert each.ee <= SHARE * system.tolerance.ee
                    assert each.pixel <= SHARE * system.tolerance.pixel
                    assert each.because
            for left_out in scene.left_out:
                assert left_out.ee <= 2.0 * SHARE * system.tolerance.ee
                assert left_out.pixel <= 2.0 * SHARE * system.tolerance.pixel


def test_everything_models_all_but_what_is_exactly_nothing():
    scene = recipe.plan(paper(*VISIBLE, "surfaces.1.psd={sigma: 0.005 nm, B: 10 mm, C: 1.8}"), everything=True)
    assert effect(scene, "scatter of secondary").modelled
    assert scene.modelled_surfaces[0] == scene.surfaces
    assert scene.left_out == (Tolerance(0.0, 0.0),)


def test_planning_warns_of_nothing_at_the_extremes():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for psd in (
            "{sigma: 1e-30 nm, B: 1 mm, C: 1.001}",
            "{sigma: 1e-200 nm, B: 1 mm, C: 2}",
            "{sigma: 900 nm, B: 1 km, C: 1000}",
            "[]",
        ):
            recipe.plan(paper(f"surfaces.0.psd={psd}", "surfaces.1.psd={sigma: 1e-5 nm, B: 1 nm, C: 1.05}"))
