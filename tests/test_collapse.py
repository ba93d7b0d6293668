"""What is left out far from the image and close to it: the clip at the horizon, and the spread of near surfaces."""

from __future__ import annotations

import math

import numpy as np
import pytest
from planned import effect, paper, planned

from psfcli import recipe
from psfcli.image.collapse import collapse, is_collapsed
from psfcli.image.horizon import clip_change, horizon_loss
from psfcli.image.scatter import scatter_terms, scattered_light
from psfcli.planning.plan import SHARE
from psfcli.surface.harvey_shack import horizon, phase_variance, total_integrated_scatter
from psfcli.surface.mixture import GaussianMixture
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Pupil, Telescope
from psfcli.tolerance import Tolerance

TELESCOPE = Telescope(0.05, Pupil(), SeidelTable(), 0.01, 1000.0)
LAMBDA = 1e-5
FINE = Tolerance(1e-9, 1e-11)


def drawn(seed):
    """One or two rough mirrors."""
    draw = np.random.default_rng(seed)
    return [
        Surface(str(i), 50.0 * 10.0 ** draw.uniform(-0.7, 0.0) ** i, (
            KCorrelation(10.0 ** draw.uniform(-7.5, -5.8), 10.0 ** draw.uniform(-2.0, 1.0), draw.uniform(1.1, 4.0)),
        ))
        for i in range(1 + seed % 2)
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_the_clip_takes_no_more_than_its_bound_from_any_density(seed):
    surfaces = drawn(seed)
    reach = 0.05 * min(TELESCOPE.magnified_distance(s.marginal_height) for s in surfaces)
    bound = clip_change(surfaces, scatter_terms(surfaces, TELESCOPE, LAMBDA), TELESCOPE, LAMBDA, reach)
    clipped = scattered_light(surfaces, TELESCOPE, LAMBDA, reach, FINE).mixture
    before = GaussianMixture(np.where(clipped.weight > 0.0, clipped.weight, 0.0), clipped.variance)
    loss = horizon_loss(surfaces, TELESCOPE, LAMBDA, before, reach).mixture
    r = np.geomspace(1e-3 * reach, reach, 100)
    taken = np.max(np.abs(loss.density(r)) / before.density(r))
    assert 0.0 < taken <= bound.pixel * (1.0 + 1e-6)  # 1e-6: of the fit
    assert 0.0 < bound.ee <= 1.0
    # not a bound that everything keeps: flat and smooth, the clip takes about e^b - 1 times pi qc^2
    if len(surfaces) == 1 and surfaces[0].psd[0].C < 2.0 and phase_variance(surfaces[0], LAMBDA) < 1.0:
        assert bound.pixel < 20.0 * taken


def test_a_clip_that_takes_too_little_is_skipped_with_its_bound():
    smooth = ("surfaces.1.psd=[]", "surfaces.0.psd={sigma: 0.5 nm, B: 1 mm, C: 3}")
    system = paper(*smooth)
    scene, images = planned(system)
    skipped = effect(scene, "horizon")
    assert not skipped.modelled
    assert 0.0 < skipped.pixel <= SHARE * system.tolerance.pixel
    assert 0.0 < skipped.ee <= SHARE * system.tolerance.ee
    # it is among the errors told
    assert images[0, 0].reached.pixel >= skipped.pixel
    assert images[0, 0].reached.ee >= skipped.ee
    # C = 1.8 has more beyond 1/lambda, and a finer request sees it
    far = "ensquared_energy={half_widths: [2 um, 21 mm]}"
    assert effect(recipe.plan(paper(far)), "horizon").modelled
    assert not effect(recipe.plan(paper(far, *smooth)), "horizon").modelled
    assert effect(recipe.plan(paper(far, *smooth, accuracy=Tolerance(1e-9, 1e-11))), "horizon").modelled
    none = effect(recipe.plan(paper("surfaces.0.psd=[]", "surfaces.1.psd=[]")), "horizon")
    assert (none.modelled, none.pixel, none.ee, none.because) == (False, 0.0, 0.0, "nothing scatters")


@pytest.mark.parametrize("C", [1.3, 2.0, 3.5])
@pytest.mark.parametrize("lengths", [1e-3, 0.1, 3.0])
def test_light_that_a_collapse_moves_is_the_mean_of_its_displacements(C, lengths):
    # smooth: scattered once if at all, |f| = (U^(2/(1-C)) - 1)^(1/2)/B below the horizon
    B = 0.01
    surface = Surface("field mirror", 1e-3, (KCorrelation(1e-9, B, C),))
    d, g = TELESCOPE.magnified_distance(1e-3), phase_variance(surface, LAMBDA)
    length = lengths * d
    edge = horizon(surface, LAMBDA)
    lowest = math.hypot(1.0, B * edge) ** (1.0 - C)
    U = lowest + (1.0 - lowest) * (np.arange(400_000) + 0.5) / 400_000
    R = LAMBDA * d * np.sqrt(U ** (2.0 / (1.0 - C)) - 1.0) / B
    moved = g * float(np.minimum(1.0, R / length).mean())
    # steps of a fifteenth of a factor e and never too low
    assert moved * (1.0 - 1e-3) <= collapse(surface, TELESCOPE, LAMBDA).error(length) <= 1.08 * moved


def test_a_collapse_never_moves_more_than_all_that_is_scattered():
    surface = Surface("field mirror", 1e-3, (KCorrelation(2e-6, 1e-3, 1.5),))
    tis = total_integrated_scatter(surface, LAMBDA)
    assert 0.9 < tis < 1.0
    assert collapse(surface, TELESCOPE, LAMBDA).error(1e-9) == tis


def test_a_surface_at_the_image_is_skipped_with_its_bound():
    scene, images = planned(paper("surfaces.1.marginal_height=1 nm"))
    skipped = effect(scene, "spread of secondary")
    assert is_collapsed(scene.scatter[0][1].magnified_distance, scene.reach)
    assert not skipped.modelled
    assert 0.0 < skipped.ee == skipped.pixel < 1e-5
    assert "joins the unscattered light" in skipped.because
    assert images[0, 0].reached.ee >= skipped.ee
    assert effect(scene, "spread of primary").modelled
    # and those that are not there yet are modelled
    assert effect(recipe.plan(paper()), "spread of secondary").modelled


def test_every_wavelength_has_its_own_horizon():
    scene = recipe.plan(paper("wavelengths=[9.4 nm, 500 nm]"))
    assert effect(scene, "horizon at 9.4 nm").pixel != effect(scene, "horizon at 500 nm").pixel
