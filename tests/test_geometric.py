"""The unscattered light, PSF_G: against counted rays, closed forms, rings of the pupil, and its own estimate."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterable

import numpy as np
import pytest
from scipy import integrate, optimize
from truth import TruthSystem
from truth.cases import SEIDEL
from truth.geometry import counted_pixels, defocused_annulus, line_focus
from truth.specular import specular_energy

from psfcli.image.blur import TAIL, ray_spacing
from psfcli.image.boxes import unscattered_in_boxes
from psfcli.image.geometric import GeometricalImage, RayBundle, geometrical_images, moment_rays, spots
from psfcli.image.graded import graded_rays
from psfcli.image.patches import EVERYWHERE, patches_apart, ray_count, rays_apart
from psfcli.image.unscattered import unscattered_in_windows, unscattered_on_grid
from psfcli.telescope.aberration import wavefront
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Pupil, Telescope

SLOPE = 95.0 / 1750.0
MAX_FIELD = math.radians(0.5)
TOLERANCES = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8]
PIXEL = 0.021


def produced(case: TruthSystem) -> GeometricalImage:
    """The product's image of the judge's case."""
    pupil = Pupil(case.obscuration, case.sector) if case.sector else Pupil(case.obscuration)
    telescope = Telescope(case.image_slope, pupil, SeidelTable(**case.seidel), MAX_FIELD, 1750.0)
    H, azimuth = math.hypot(*case.field), math.atan2(case.field[1], case.field[0])
    field = Field(math.atan(H * math.tan(MAX_FIELD)), azimuth if H else math.pi / 2.0)
    return geometrical_images(telescope, [field])[0]


def case_of(field=(0.0, 1.0), obscuration=0.48, sector=None, **seidel) -> TruthSystem:
    return TruthSystem(1e-5, (), SLOPE, obscuration, seidel, field, sector)


def reach(case: TruthSystem) -> float:
    spot = produced(case).spot
    return max(-spot.x_min, spot.x_max, -spot.y_min, spot.y_max)


def around(case: TruthSystem, cells: int = 7) -> np.ndarray:
    """Edges of a grid that cuts the spot unevenly, a part of it left outside."""
    r = reach(case)
    return np.linspace(-0.93 * r, 1.01 * r, cells + 1)


def landed(point: GeometricalImage, spacing: float, window=EVERYWHERE) -> RayBundle:
    """All rays ``spacing`` apart that land near the window."""
    return joined(patches_apart(point, spacing, window=window))


def joined(parts: Iterable[RayBundle]) -> RayBundle:
    """All rays of some bundles."""
    each = list(parts)
    return RayBundle(*(np.concatenate([getattr(p, name).ravel() for p in each]) for name in ("share", "x", "y")))


@functools.cache
def judged_cells(index: int) -> tuple[np.ndarray, list[tuple[int, int]], np.ndarray]:
    """Edges, some cells (row, column) and what rings of the pupil say of them, for CASES[index]."""
    case = CASES[index]
    edges = around(case)
    grid, _ = unscattered_on_grid(produced(case), edges, edges, 1e-4)
    lit = [tuple(map(int, cell)) for cell in np.argwhere((grid > 1e-3) & (grid < 0.999))]
    cells = lit[:: max(1, len(lit) // 3)][:3]
    exact = [specular_energy(case, edges[j], edges[j + 1], edges[i], edges[i + 1], 1e-10) for i, j in cells]
    return edges, cells, np.array(exact)


def random_case(seed: int) -> TruthSystem:
    rng = np.random.default_rng(seed)
    names = ("W020", "W040", "W131", "W222", "W220", "W311")
    size = 10.0 ** rng.uniform(-5.0, -3.0)
    seidel = {name: float(w) for name, w in zip(names, size * rng.normal(size=6), strict=True)}
    field = tuple(float(h) for h in rng.uniform(-1.0, 1.0, 2)) if seed % 2 else (0.0, float(rng.uniform(-1.0, 1.0)))
    start = float(rng.uniform(0.0, 4.0))
    sector = (start, start + float(rng.uniform(0.3, 5.0))) if seed % 3 == 0 else None
    return TruthSystem(1e-5, (), SLOPE, (0.0, 0.48, 0.95)[seed % 3], seidel, field, sector)


CASES = [
    *(case_of((0.0, h), o, **SEIDEL) for h in (0.0, 0.5, 1.0) for o in (0.0, 0.48, 0.95)),
    case_of((0.0, 1.0), 0.48, (math.pi / 3.0, 2.0 * math.pi / 3.0), **SEIDEL),
    case_of((0.6, -0.8), 0.48, (5.0, 8.0), **SEIDEL),
    *(random_case(seed) for seed in range(12)),
]


@pytest.mark.parametrize("index", range(len(CASES)))
def test_cells_are_within_every_tolerance_and_errors_are_told(index):
    edges, cells, exact = judged_cells(index)
    point = produced(CASES[index])
    rows, columns = np.array(cells).T
    for tolerance in TOLERANCES[index % 2 :: 2]:
        grid, told = unscattered_on_grid(point, edges, edges, tolerance)
        true = np.abs(grid[rows, columns] - exact).max()
        rings = 2e-10  # of the judge, against closed forms
        assert true <= tolerance + rings
        assert told >= (true - rings) / 3.0
        assert grid.sum() <= 1.0 + tolerance


@pytest.mark.parametrize("index", [3, 7, 9, 12, 18])
def test_boxes_are_within_every_tolerance_and_errors_are_told(index):
    case = CASES[index]
    point, r = produced(case), reach(case)
    half_width, centres = r * np.array([0.03, 0.4]), [(0.0, 0.0), (0.13 * r, -0.2 * r)]
    exact = np.array(
        [[specular_energy(case, x - h, x + h, y - h, y + h, 1e-10) for h in half_width] for x, y in centres]
    )
    for tolerance in (1e-3, 1e-5, 1e-8):
        ((boxes, told),) = unscattered_in_boxes([point], [centres], half_width, tolerance)
        true = np.abs(boxes - exact).max()
        assert true <= tolerance + 2e-10  # the judge's, as above
        assert told >= (true - 2e-10) / 3.0


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7])  # few slices of each, and more than are looked at together
def test_points_together_are_to_the_last_bit_what_each_is_alone(tolerance):
    cases = [case_of((0.0, H), **SEIDEL) for H in (1.0, 0.0, 0.3)] + [case_of((0.5, 0.4), **SEIDEL)]
    points = [produced(case) for case in cases]
    edges = 1.1 * reach(cases[0]) * np.linspace(-1.0, 1.0, 41)
    windows = [np.s_[0:40, 0:40], np.s_[15:25, 15:25], np.s_[3:37, 2:38], np.s_[0:9, 0:40]]
    strict = np.array([tolerance, 0.1 * tolerance, tolerance, 3.0 * tolerance])
    together = unscattered_in_windows(points, edges, edges, windows, strict)
    for n, (grid, told) in enumerate(together):
        ((alone, told_alone),) = unscattered_in_windows(
            points[n : n + 1], edges, edges, windows[n : n + 1], strict[n : n + 1]
        )
        cut, _ = unscattered_on_grid(
            points[n], *(edges[part.start : part.stop + 1] for part in windows[n][::-1]), strict[n]
        )
        assert grid.tobytes() == alone.tobytes()
        assert told == told_alone
        np.testing.assert_allclose(grid, cut, rtol=0.0, atol=1e-14)
    centres = [[(0.0, 0.0), (point.spot.chief_x, point.spot.chief_y)] for point in points]
    half_width = reach(cases[0]) * np.geomspace(0.01, 1.0, 30)
    boxes = unscattered_in_boxes(points, centres, half_width, tolerance)
    for point, some, (inside, told) in zip(points, centres, boxes, strict=True):
        ((alone, told_alone),) = unscattered_in_boxes([point], [some], half_width, tolerance)
        assert inside.tobytes() == alone.tobytes()
        assert told == told_alone


@pytest.mark.parametrize("index", [0, 4, 7, 9, 10, 14])
def test_rays_counted_as_in_the_papers_appendix_agree(index):
    case = CASES[index]
    edges = around(case, 5)
    grid, _ = unscattered_on_grid(produced(case), edges, edges, 1e-6)
    counted = counted_pixels(case, edges, edges, rays=1201)
    # rays on a grid: each boundary that crosses the pupil errs by up to its length over the rays in a row
    np.testing.assert_allclose(grid, counted, atol=8e-4)


# -- closed forms


@pytest.mark.parametrize("obscuration", [0.0, 0.48, 0.95])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_defocus_is_an_annulus_cut_by_pixels(obscuration, tolerance):
    case = case_of((0.0, 0.0), obscuration, W020=3e-4)
    radius = 2.0 * 3e-4 / SLOPE
    edges_x, edges_y = radius * np.linspace(-1.1, 0.95, 8), radius * np.linspace(-0.7, 1.2, 6)
    grid, told = unscattered_on_grid(produced(case), edges_x, edges_y, tolerance)
    exact = [
        [defocused_annulus(radius, obscuration, x0, x1, y0, y1) for x0, x1 in itertools.pairwise(edges_x)]
        for y0, y1 in itertools.pairwise(edges_y)
    ]
    true = np.abs(grid - exact).max()
    assert true <= tolerance
    assert told >= true / 3.0


def coma_below(y: float, obscuration: float) -> float:
    """Energy of pure coma below y, in units of W131/u' and for y > 0: rings rho are circles rho^2 (2 + cos 2 phi)."""

    def share(p):  # of the ring with rho^2 = p
        return 1.0 - math.acos(min(1.0, max(-1.0, y / p - 2.0))) / math.pi

    inner = obscuration**2
    breaks = [b for b in (y / 3.0, y) if inner < b < 1.0]
    lit, _ = integrate.quad(share, inner, 1.0, points=breaks or None, epsabs=1e-11, limit=200)
    return lit / (1.0 - inner)


@pytest.mark.parametrize("obscuration", [0.0, 0.48])
def test_coma_is_a_flare_of_circles_in_a_wedge_of_sixty_degrees(obscuration):
    case = case_of((0.0, 1.0), obscuration, W131=-1e-4)
    unit, tolerance = 1e-4 / SLOPE, 1e-7
    point = produced(case)
    wide = np.array([-4.0, 4.0]) * unit
    for y in (0.31, 1.0, 1.7, 2.9):
        strip, _ = unscattered_on_grid(point, wide, np.array([-1.0, y]) * unit, tolerance)
        assert strip[0, 0] == pytest.approx(coma_below(y, obscuration), abs=tolerance)
    # below any y the wedge |x| < y tan 30 deg holds it all, and nothing less does
    for y in (0.7, 3.0):
        side = y * math.tan(math.radians(30.0)) * unit
        below = np.array([-1.0, y]) * unit
        wedge, part = (
            float(unscattered_on_grid(point, side * np.array([-share, share]), below, tolerance)[0][0, 0])
            for share in (1.001, 0.45)
        )
        assert wedge == pytest.approx(coma_below(y, obscuration), abs=tolerance)
        assert part < 0.97 * wedge  # it lies at the caustic of its rim, and thins out above


@pytest.mark.parametrize("obscuration", [0.0, 0.48, 0.95])
def test_a_line_focus_has_a_length_and_no_width(obscuration):
    # the sagittal rays meet at one x; the tangential ones spread along y
    half_length = 2.0 * 2e-4 / SLOPE
    point = produced(case_of((0.0, 1.0), obscuration, W222=2e-4))
    edges_y = half_length * np.array([-1.02, -0.62, -0.22, 0.18, 0.58, 0.98])
    grid, _ = unscattered_on_grid(point, half_length * np.array([-0.5, 0.0, 0.5]), edges_y, 1e-8)
    exact = [line_focus(half_length, obscuration, a, b) for a, b in itertools.pairwise(edges_y)]
    np.testing.assert_allclose(grid.sum(axis=1), exact, atol=1e-8)
    tangential = produced(case_of((0.0, 1.0), obscuration, W222=2e-4, W220=-2e-4))  # now y is sharp
    half_width = half_length * np.array([1e-9, 0.3, 1.0 + 1e-9])
    ((boxes, _),) = unscattered_in_boxes([tangential], [[(0.0, 0.0)]], half_width, 1e-8)
    exact = [line_focus(half_length, obscuration, -h, h) for h in half_width]
    np.testing.assert_allclose(boxes[0], exact, atol=1e-8)


@pytest.mark.parametrize("sector", [None, (0.4, 1.9)])
def test_a_perfect_image_lies_on_a_pixel_or_is_shared_by_four(sector):
    point = produced(case_of(sector=sector))
    corner, _ = unscattered_on_grid(point, PIXEL * np.arange(-2, 3), PIXEL * np.arange(-2, 3), 1e-8)
    np.testing.assert_allclose(corner[1:3, 1:3], 0.25, rtol=1e-12)  # rounding
    assert corner.sum() == pytest.approx(1.0, abs=1e-12)
    centre, _ = unscattered_on_grid(point, PIXEL * (np.arange(4) - 1.5), PIXEL * (np.arange(4) - 1.5), 1e-8)
    assert centre[1, 1] == pytest.approx(1.0, abs=1e-12)
    half_width = PIXEL * np.array([1e-6, 2.0, 4.0])
    ((boxes, _),) = unscattered_in_boxes([point], [[(0.0, 0.0), (0.0, 3.0 * PIXEL)]], half_width, 1e-8)
    np.testing.assert_allclose(boxes, [[1.0, 1.0, 1.0], [0.0, 0.0, 1.0]], atol=1e-12)


def test_a_pure_shift_moves_the_perfect_image():
    case = case_of((0.6, 0.8), W311=-PIXEL * SLOPE)  # one pixel along the field
    edges = PIXEL * (np.arange(6) - 2.5)
    grid, _ = unscattered_on_grid(produced(case), edges, edges, 1e-8)
    assert grid[3, 3] == pytest.approx(1.0, abs=1e-12)  # 0.6 and 0.8 of a pixel: the next one, up and right


def test_the_whole_field_of_pixels_holds_all_the_light():
    for case in CASES[::6]:
        point = produced(case)
        edges = reach(case) * np.linspace(-1.01, 1.01, 33)
        grid, told = unscattered_on_grid(point, edges, edges, 1e-6)
        assert grid.min() >= 0.0
        assert grid.sum() == pytest.approx(1.0, abs=1e-9)  # every piece of every fan lands somewhere
        assert told <= 1e-6


def test_finer_obscurations_make_thinner_rings_of_the_same_light():
    # obscuration -> 1: one ring; defocus puts all of it at one radius
    point = produced(case_of((0.0, 0.0), 1.0 - 1e-9, W020=3e-4))
    radius = 2.0 * 3e-4 / SLOPE
    half_width = radius * np.array([0.7, math.sqrt(0.5), 0.9, 1.0])
    ((boxes, _),) = unscattered_in_boxes([point], [[(0.0, 0.0)]], half_width, 1e-7)
    # a square of half width h > r/sqrt 2 cuts four arcs of half angle arccos(h/r)
    expected = [0.0, 0.0, 1.0 - 8.0 * math.acos(0.9) / (2.0 * math.pi), 1.0]
    np.testing.assert_allclose(boxes[0][[0, 2, 3]], [expected[0], expected[2], expected[3]], atol=1e-6)


@pytest.mark.parametrize("obscuration", [0.0, 0.48])
def test_defocus_in_a_sector_is_a_sector_of_a_disc(obscuration):
    """Its centroid and rms in closed form, and blurs to rounding by moments and by rays of either kind."""
    start, stop, radius = 0.3, 2.1, 0.05
    point = produced(case_of(obscuration=obscuration, sector=(start, stop), W020=-0.5 * radius * SLOPE))
    lit = 0.5 * (1.0 - obscuration**2) * (stop - start)

    def mean(power: int, cos: int, sin: int) -> float:  # of (radius rho)^power cos^cos sin^sin
        angles = integrate.quad(lambda a: math.cos(a) ** cos * math.sin(a) ** sin, start, stop, epsabs=1e-15)[0]
        return radius**power * (1.0 - obscuration ** (power + 2)) / (power + 2) * angles / lit

    assert point.spot.centroid_x == pytest.approx(mean(1, 1, 0), rel=1e-13)
    assert point.spot.centroid_y == pytest.approx(mean(1, 0, 1), rel=1e-13)
    assert point.spot.rms_x == pytest.approx(math.sqrt(mean(2, 2, 0) - mean(1, 1, 0) ** 2), rel=1e-12)
    width = 0.2 * radius
    for rays in (
        moment_rays(point.telescope, [point.field])[0],
        landed(point, 0.5 * width),
        joined(rays_apart(point, 0.5 * width, 6)),
        graded_rays(point, lambda x, _: np.full_like(x, 0.15 * width), 7),
    ):
        assert rays.share.sum() == pytest.approx(1.0, rel=1e-12)
        assert rays.share @ np.hypot(rays.x, rays.y) ** 3 == pytest.approx(mean(3, 0, 0), rel=1e-12)
        seen = rays.share @ np.exp(-0.5 * (rays.x**2 + rays.y**2) / width**2)
        variance = (width / radius) ** 2
        exact = variance * (math.exp(-0.5 * obscuration**2 / variance) - math.exp(-0.5 / variance))
        assert seen == pytest.approx(exact / (0.5 * (1.0 - obscuration**2)), rel=1e-7)


def test_graded_rays_are_as_close_as_asked_where_they_turn_back():
    """A fan that moves out from the axis and back by its end, through a Gaussian: its ends are not far apart."""
    radius = 0.05
    point = produced(case_of((0.0, 0.0), 0.0, W020=-0.5 * radius * SLOPE, W040=0.25 * radius * SLOPE))
    width = 0.1 * radius

    def blurred(rho: float) -> float:
        return 2.0 * rho * math.exp(-0.5 * (radius * (rho - rho**3) / width) ** 2)

    rays = graded_rays(point, lambda x, _: np.full_like(x, 0.5 * width), 9)
    seen = rays.share @ np.exp(-0.5 * (rays.x**2 + rays.y**2) / width**2)
    assert seen == pytest.approx(integrate.quad(blurred, 0.0, 1.0, epsabs=1e-14)[0], rel=1e-9)


@pytest.mark.parametrize("sector", [None, (0.3, 2.1)], ids=["annulus", "sector"])
@pytest.mark.parametrize("place", [0.0, 0.5])
def test_rays_are_as_close_as_asked_about_the_pupils_centre_too(sector, place):
    """A disc blurred by what is far narrower, seen in its middle or half-way to its rim: 1 over its area."""
    radius, width, start = 0.05, 2e-4, 1.2  # start: an azimuth well inside the sector
    point = produced(case_of(obscuration=0.0, sector=sector, W020=-0.5 * radius * SLOPE))
    x, y = place * radius * math.cos(start), place * radius * math.sin(start)
    angle = 2.0 * math.pi if sector is None else sector[1] - sector[0]
    lit = angle / (2.0 * math.pi) if place == 0.0 else 1.0  # of the Gaussian
    wide = TAIL * width
    window = x - wide, x + wide, y - wide, y + wide
    for error in (1e-3, 1e-6):
        rays = landed(point, float(ray_spacing(np.array(width), np.array(error))), window)
        seen = rays.share @ np.exp(-0.5 * ((rays.x - x) ** 2 + (rays.y - y) ** 2) / width**2)
        assert seen == pytest.approx(lit * 2.0 * math.pi * width**2 / (0.5 * angle * radius**2), rel=error)
        assert rays.share.size < 0.1 * ray_count(point).at(np.array(width))


def test_sectors_add_up_to_the_annulus():
    whole = case_of((0.0, 1.0), 0.48, **SEIDEL)
    edges = around(whole)
    full, _ = unscattered_on_grid(produced(whole), edges, edges, 1e-7)
    bounds = [0.3, 1.5, 4.0, 0.3 + 2.0 * math.pi]
    parts = [
        (b - a) / (2.0 * math.pi)
        * unscattered_on_grid(produced(dataclasses.replace(whole, sector=(a, b))), edges, edges, 1e-7)[0]
        for a, b in itertools.pairwise(bounds)
    ]  # fmt: skip
    np.testing.assert_allclose(sum(parts), full, atol=2e-7)  # 1e-7 each way


@pytest.mark.parametrize("seed", range(40))
def test_the_spot_reaches_as_far_as_its_farthest_rays(seed):
    # the gradient of the wavefront by central differences, which are exact for its fourth powers but for step^2
    draw = np.random.default_rng(seed)
    inner = draw.uniform(0.0, 0.95)
    low, high = np.sort(draw.uniform(0.0, 2.0 * math.pi, 2)) if seed % 2 else (0.0, 2.0 * math.pi)
    seidel = SeidelTable(*(draw.uniform(-1.0, 1.0, 6) * 10.0 ** draw.uniform(-3.0, 0.0, 6) * 1e-4))
    telescope = Telescope(SLOPE, Pupil(inner, (low, high)), seidel, MAX_FIELD, 1750.0)
    field = Field(draw.uniform(-MAX_FIELD, MAX_FIELD), draw.uniform(0.0, 6.0) if seed % 3 else math.pi / 2.0)
    spot, relative, step = spots(telescope, [field])[0], telescope.relative_field(field), 1e-3

    def landing(axis, rho, azimuth):
        x, y = rho * np.cos(azimuth), rho * np.sin(azimuth)
        dx, dy = (step, 0.0) if axis == 0 else (0.0, step)

        def slope(h):
            W = [wavefront(seidel, relative, x + s * h * dx, y + s * h * dy) for s in (1.0, -1.0)]
            return (W[0] - W[1]) / (2.0 * h * step)

        return -(4.0 * slope(1.0) - slope(2.0)) / 3.0 / SLOPE

    rho, azimuth = np.meshgrid(np.linspace(inner, 1.0, 65), np.linspace(low, high, 1025), indexing="ij")
    for axis, ends in enumerate(((spot.x_min, spot.x_max), (spot.y_min, spot.y_max))):
        size = ends[1] - ends[0]
        for sign, end in zip((-1.0, 1.0), ends, strict=True):
            samples = sign * landing(axis, rho, azimuth)
            best = np.unravel_index(samples.argmax(), samples.shape)
            found = optimize.minimize(
                lambda p, axis=axis, sign=sign, size=size: -sign * landing(axis, p[0], p[1]) / size,
                [rho[best], azimuth[best]],
                method="L-BFGS-B",
                bounds=[(inner, 1.0), (low, high) if seed % 2 else (low - 1.0, high + 1.0)],
                options={"ftol": 1e-16, "gtol": 1e-12},
            )
            farthest = max(samples.max() / size, -found.fun)
            # 1e-10: rounding of the differences; 256 azimuths alone are short by up to 1e-4
            assert sign * end / size == pytest.approx(farthest, abs=1e-10)
