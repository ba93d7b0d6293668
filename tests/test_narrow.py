"""Gaussians narrower than the spot: grid of rays, blurred fans and table of squares, one against the other."""

import math

import numpy as np
import pytest

from psfcli.image.blur import FEW_TERMS, fewer_terms, normal_probability
from psfcli.image.boxes import blurred_in_boxes, unscattered_in_boxes
from psfcli.image.geometric import geometrical_images, moment_rays, ray_bundles
from psfcli.image.graded import graded_rays
from psfcli.image.narrow import narrow_in_squares
from psfcli.image.square_polynomials import common_extent, polynomial_response, truncation_error
from psfcli.image.squares import square_response
from psfcli.surface.mixture import GaussianMixture
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Pupil, Telescope

WAVE = 9.4e-6  # mm
TABLE = SeidelTable(*(WAVE * w for w in (-30.35, 0.42, -7.6, 48.34, 38.58, -5.48)))
CENTRES = [(0.0, 0.0), (0.004, -0.003)]
TILTED = Field(math.radians(0.4), math.radians(30.0))
UPRIGHT = Field(math.radians(0.5))
ON_AXIS = Field(0.0, math.radians(30.0))  # an azimuth that the image does not have


def point(field, pupil=None):
    telescope = Telescope(0.0543, pupil or Pupil(0.48), TABLE, math.radians(0.5), 1750.0)
    return geometrical_images(telescope, [field])[0]


def extent(image):
    return max(image.spot.x_max - image.spot.x_min, image.spot.y_max - image.spot.y_min)


def by_rays(image, mixture, centres, half_width):
    """The plain sum over very many rays, the whole of the other half of the pupil included."""
    rays = ray_bundles(image.telescope, [image.field], 100, 400)[0]
    energy = np.zeros((len(centres), half_width.size))
    for weight, s in zip(mixture.weight, np.sqrt(mixture.variance), strict=True):
        for n, (x, y) in enumerate(centres):
            for b, w in enumerate(half_width):
                in_x = normal_probability((x - w - rays.x) / s, (x + w - rays.x) / s)
                in_y = normal_probability((y - w - rays.y) / s, (y + w - rays.y) / s)
                energy[n, b] += weight * float(rays.share @ (in_x * in_y))
    return energy


@pytest.mark.parametrize("field", [TILTED, UPRIGHT, ON_AXIS], ids=["tilted", "upright", "on axis"])
@pytest.mark.parametrize("pupil", [Pupil(0.48), Pupil(0.2, (0.3, 2.0))], ids=["annulus", "sector"])
def test_grid_and_fans_hold_what_very_many_rays_say(field, pupil):
    image = point(field, pupil)
    half_width = extent(image) * np.array([0.01, 0.1, 0.3, 0.6, 2.0])
    mixture = GaussianMixture(np.array([0.3, 0.2]), (extent(image) / np.array([40.0, 15.0])) ** 2)
    expected = by_rays(image, mixture, CENTRES, half_width)  # these rays err by exp(-2 pi^2 s^2/spacing^2): nothing
    fans, told = blurred_in_boxes(image, CENTRES, half_width, np.full(2, 1e-8), mixture)
    np.testing.assert_allclose(fans, expected, atol=2e-8)  # asked, and as much for the blur of edges
    assert 0.0 < told <= 1e-8
    tight = np.full(2, 1e-9)
    gridded, _ = narrow_in_squares(image, mixture, CENTRES, half_width, np.full(2, 1e-9), np.full(2, 1e-30))
    np.testing.assert_allclose(gridded, expected, atol=float(tight.sum()))


def test_a_window_is_lit_by_rays_near_it_alone():
    image = point(TILTED)
    (rays,) = moment_rays(image.telescope, [image.field])
    centres = [(float(rays.x[n]), float(rays.y[n])) for n in (100, 103)]
    half_width = extent(image) * np.array([0.01, 0.03])
    mixture = GaussianMixture(np.array([0.3, 0.2]), (extent(image) / np.array([300.0, 100.0])) ** 2)
    error, never = np.full(2, 1e-9), np.full(2, 1e-30)
    near, _ = narrow_in_squares(image, mixture, centres, half_width, error, never)
    whole, _ = narrow_in_squares(image, mixture, centres, np.append(half_width, 2.0 * extent(image)), error, never)
    np.testing.assert_allclose(near, whole[:, :2], atol=1e-11)
    assert near.min() > 1e-5
    np.testing.assert_allclose(whole[:, 2], 0.5, rtol=1e-9)


def test_fans_are_not_cut_where_their_gaussian_does_not_reach():
    image = point(TILTED)
    centres = [(0.0, 0.0), (5.0 * extent(image), 0.0)]
    mixture = GaussianMixture(np.array([1e-4]), (extent(image) / np.array([1e5])) ** 2)  # too many rays
    half_width, error = 0.1 * extent(image) * np.ones(1), np.full(1, 1e-3)
    (inside, beyond), _ = narrow_in_squares(image, mixture, centres, half_width, error, np.array([1e-9, 1e-30]))
    assert inside > 0.0
    assert beyond == 0.0
    assert narrow_in_squares(image, mixture, centres[1:], half_width, error, np.array([1e-30])) == (0.0, 0.0)


@pytest.mark.parametrize("field", [TILTED, UPRIGHT, ON_AXIS], ids=["tilted", "upright", "on axis"])
@pytest.mark.parametrize("pupil", [Pupil(0.48), Pupil(0.2, (0.3, 2.0))], ids=["annulus", "sector"])
def test_the_table_of_squares_holds_wide_and_narrow_terms_alike(field, pupil):
    image = point(field, pupil)
    half_width = extent(image) * np.array([0.02, 0.2, 0.5, 1.0, 5.0, 50.0])
    mixture = GaussianMixture(np.full(8, 0.1), (extent(image) * np.geomspace(0.03, 30.0, 8)) ** 2)
    expected = by_rays(image, mixture, CENTRES, half_width)
    for tolerance in (1e-4, 1e-6, 1e-8):
        energy, _ = square_response(mixture, half_width, half_width).energy(image, CENTRES, tolerance)
        assert np.abs(energy - expected).max() <= tolerance


@pytest.mark.parametrize("ratio", [1e-3, 0.1, 1.0, 3.0, 10.0, 30.0])
def test_what_a_series_leaves_out_is_within_its_bound(ratio):
    """By interpolation of Gaussians in squares of all sizes, at places between the nodes; the bound is no loose one."""
    place, edge = np.linspace(0.0, 1.0, 301), np.geomspace(1e-3, 3.0, 40)[:, None]
    f = normal_probability(ratio * (place - edge), ratio * (place + edge))
    for count in (4, 8, 16, 32, 48):
        node = np.cos(0.5 * math.pi * (np.arange(count) + 0.5) / count)
        at_nodes = normal_probability(ratio * (node - edge), ratio * (node + edge))
        series = np.polynomial.chebyshev.chebfit(2.0 * node**2 - 1.0, at_nodes.T, count - 1)
        error = np.abs(np.polynomial.chebyshev.chebval(2.0 * place**2 - 1.0, series) - f).max()
        bound = truncation_error(np.array(ratio), np.array(count))
        assert error <= bound + 1e-12  # rounding of the fit
        if 1e-10 < error < 1e-2:
            assert bound < 300.0 * error  # five polynomials more than needed at most


def test_spots_of_like_extent_share_a_table_that_ends_with_the_spot():
    upright, tilted = point(UPRIGHT), point(Field(math.radians(0.49)))
    mixture = GaussianMixture(np.full(3, 0.1), (extent(upright) * np.array([0.1, 1.0, 10.0])) ** 2)
    half_width = extent(upright) * np.array([0.1, 1.0])
    response = square_response(mixture, half_width, half_width)
    for image in (upright, tilted):
        response.energy(image, CENTRES[:1], 1e-6)
        reach = max(abs(bound) for bound in (image.spot.x_min, image.spot.x_max, image.spot.y_min, image.spot.y_max))
        assert reach <= common_extent(image, CENTRES[:1], 0.0) < 1.42 * reach
    assert len(response.tables) == 1


def test_gaussians_far_narrower_than_the_spot_are_not_in_the_table():
    image = point(UPRIGHT)
    mixture = GaussianMixture(np.full(4, 0.1), (extent(image) * np.array([1e-4, 1e-3, 0.1, 1.0])) ** 2)
    table = polynomial_response(mixture, extent(image) * np.array([0.1, 1.0]), extent(image), 1e-6)
    assert table.first == 2
    alone = polynomial_response(mixture.only(np.arange(2)), np.ones(1), extent(image), 1e-6)
    assert alone.first == 2
    np.testing.assert_array_equal(alone.energy(image, CENTRES), np.zeros((2, 1)))


def test_ten_thousand_squares_make_no_table_of_gigabytes():
    image = point(UPRIGHT)
    mixture = GaussianMixture(np.full(3, 0.1), (extent(image) * np.array([0.1, 1.0, 10.0])) ** 2)
    half_width = extent(image) * np.linspace(0.001, 10.0, 10_000)
    many = square_response(mixture, half_width, half_width)
    energy, _ = many.energy(image, CENTRES, 1e-6)
    (table,) = many.tables.values()
    assert table.response.nbytes <= 2**25
    few = half_width[::999]
    np.testing.assert_allclose(
        energy[:, ::999], square_response(mixture, few, few).energy(image, CENTRES, 1e-6)[0], atol=1e-6
    )


def test_what_small_squares_hold_is_no_noise_however_little_is_asked():
    """A hundredth asked of energies of which the smallest is a millionth: no less, for its own sake, than one digit."""
    image = point(UPRIGHT)
    mixture = GaussianMixture(np.full(3, 0.3), (extent(image) * np.array([0.2, 1.0, 10.0])) ** 2)
    half_width = extent(image) * np.array([0.001, 0.01, 0.1])
    energy, _ = square_response(mixture, half_width, half_width).energy(image, CENTRES, 1e-2)
    np.testing.assert_allclose(energy, by_rays(image, mixture, CENTRES, half_width), rtol=0.1)


def test_a_point_sees_the_table_without_error():
    telescope = Telescope(0.0543, Pupil(0.48), SeidelTable(), math.radians(0.5), 1750.0)
    (image,) = geometrical_images(telescope, [UPRIGHT])
    width, half_width = np.array([0.01, 0.1, 1.0]), np.array([0.02, 0.2, 2.0])
    mixture = GaussianMixture(np.full(3, 0.1), width**2)
    energy, _ = square_response(mixture, half_width, half_width).energy(image, [(0.0, 0.0)], 1e-3)
    exact = 0.1 * np.sum(normal_probability(-half_width / width[:, None], half_width / width[:, None]) ** 2, axis=0)
    np.testing.assert_allclose(energy[0], exact, rtol=1e-14)


def test_a_gaussian_of_no_width_is_no_blur():
    image = point(TILTED)
    half_width = extent(image) * np.array([0.1, 0.3, 0.6])
    ((sharp, _),) = unscattered_in_boxes([image], [CENTRES], half_width, 1e-8)
    blurred, _ = blurred_in_boxes(
        image, CENTRES, half_width, np.full(2, 1e-8), GaussianMixture(np.ones(1), np.array([1e-18]))
    )
    np.testing.assert_allclose(blurred, sharp, atol=3e-8)


def test_fewer_terms_do_to_edges_what_all_did():
    image = point(UPRIGHT)
    half_width = extent(image) * np.array([0.05, 0.2, 0.4, 0.7])
    width = extent(image) * np.geomspace(1e-4, 3e-3, 14)
    mixture = GaussianMixture(np.geomspace(0.001, 0.05, 14), width**2)
    few = fewer_terms(mixture)
    assert few.weight.size == FEW_TERMS
    assert few.weight.sum() == pytest.approx(mixture.weight.sum(), rel=1e-13)
    assert few.weight @ few.variance == pytest.approx(mixture.weight @ mixture.variance, rel=1e-12)
    all_terms, some = (blurred_in_boxes(image, CENTRES, half_width, np.full(2, 1e-8), m)[0] for m in (mixture, few))
    np.testing.assert_allclose(some, all_terms, atol=1e-7)  # what both integrals and the rule may leave


def test_fewer_terms_stand_for_widths_over_decades_in_squares_narrower_than_most():
    image = point(TILTED)
    half_width = extent(image) * np.array([0.005, 0.02, 0.1])
    mixture = GaussianMixture(np.full(24, 1.0 / 24.0), (extent(image) * np.geomspace(1e-4, 0.1, 24)) ** 2)
    all_terms, some = (
        blurred_in_boxes(image, CENTRES, half_width, np.full(2, 1e-8), m)[0]
        for m in (mixture, fewer_terms(mixture, 12))
    )
    np.testing.assert_allclose(some, all_terms, atol=1e-7)  # 3e-8 measured


def test_graded_rays_are_a_quadrature_of_the_pupil():
    image = point(TILTED)
    rays = graded_rays(image, lambda x, y: np.maximum(0.05 * np.hypot(x - 0.002, y), 1e-4), 5)
    assert rays.share.sum() == pytest.approx(1.0, abs=1e-12)
    assert rays.share @ rays.x == pytest.approx(image.spot.centroid_x, abs=1e-10)
    assert rays.share @ (rays.y - image.spot.centroid_y) ** 2 == pytest.approx(image.spot.rms_y**2, rel=1e-8)


def test_boxes_computed_together_are_those_computed_alone():
    images = [point(field) for field in (UPRIGHT, TILTED, ON_AXIS)]
    half_width = 0.021 * np.array([0.1, 0.5, 1.0, 2.0, 30.0])
    together = unscattered_in_boxes(images, [CENTRES, CENTRES[:1], CENTRES], half_width, 1e-6)
    for image, centres, (inside, _) in zip(images, [CENTRES, CENTRES[:1], CENTRES], together, strict=True):
        ((alone, error),) = unscattered_in_boxes([image], [centres], half_width, 1e-6)
        np.testing.assert_allclose(inside, alone, atol=1e-6)
        assert error <= 1e-6
