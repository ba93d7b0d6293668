"""The accuracy asked for is the accuracy got, whatever the system: random system files held against the judge.

``make accuracy`` does the same for as many as one likes, and tells how well the errors are estimated.
"""

import pytest
from promise import ASKED, examined, kept, truth_of
from truth.random_systems import CORES_ACROSS, PIXELS_ACROSS, core_width, drawn, spot_extent
from truth.scenes import judged, mm

SEED, DRAWS = 20120203, range(60)
CURED = {  # (seed, number): once beyond their accuracy, or told to be
    (7, 2): "an unobscured sector",
    (7, 42): "many cores narrower than a sub-pixel",
    (1, 31): "a clip at the horizon that takes less than rounding from 1",
    (11, 27): "a spot that just misses the window",
    (11, 79): "a pixel in a disc's hole, its corner nearer to the rim than a sub-pixel",
    (11, 442): "a window in the hole of a ring of light",
    (11, 842): "a spot that the rays about the window cut into few cells",
    (12, 499): "a small square on a line of light, seen along it by few rays",
    (12, 713): "a line of light as thin as none",
    (12, 752): "a square whose corner just touches the light",
    (14, 409): "kinks near the ends of slices, alike on all sides of a square",
    (23, 980): "cores along fans that are halved no further, however finely they are judged",
    (101, 37): "a mixture that errs as little as one ten times finer",
    (101, 39): "a halo that reaches just to the corners of the largest square",
    (102, 19): "a spot across an edge, its cores narrower than a sub-pixel and as wide as itself",
    (103, 18): "a spot that distortion puts far beside the window",
    (104, 9): "a flat wing in a large square",
}
LOOSE = {(12, 499), (23, 980)}  # missed at the two loosest accuracies alone; the finer ones take most of a minute
FALL_SHORT: dict[int, str] = {}  # the draws that end with exit code 3, and their limit: at most 2 %


@pytest.mark.parametrize("number", DRAWS)
def test_true_errors_are_within_what_was_asked_and_within_three_times_what_was_told(number):
    runs = examined(SEED, number).runs
    broken = [f"at {run.asked.pixel:.0e}: {violation}" for run in runs for violation in run.violations]
    assert not broken, "\n".join(broken)
    assert [run.asked.pixel for run in runs] == list(ASKED)
    unmet = [f"at {run.asked.pixel:.0e}: {run.refused or run.short}" for run in runs if run.short]
    assert bool(unmet) == (number in FALL_SHORT), unmet


@pytest.mark.parametrize(("seed", "number"), CURED, ids=CURED.values())
def test_what_was_once_missed_is_met(seed, number):
    found = examined(seed, number, ASKED[:2] if (seed, number) in LOOSE else ASKED)
    assert [violation for run in found.runs for violation in run.violations] == []
    assert [run.short for run in found.runs if run.short] == []


@pytest.mark.parametrize("number", [5, 12, 13, 15, 17])
def test_spots_far_wider_than_are_drawn_are_met_as_well_or_told(number):
    scene, times_beyond = drawn(SEED, number), 30.0
    system, pixel = judged(scene), mm(scene["detector"]["pixel"])
    spot = spot_extent(system)
    factor = times_beyond / max(spot / (PIXELS_ACROSS * pixel), spot / (CORES_ACROSS * core_width(system)))
    seidel = scene["telescope"]["seidel"]
    for name in seidel.keys() - {"reference_wavelength"}:
        seidel[name] *= float(factor)
    assert spot_extent(judged(scene)) == pytest.approx(factor * spot)
    # a refusal or exit code 3 would be right, an error beyond what is told would not
    assert kept(scene, 1e-2, truth_of(scene)).violations == ()


def test_few_draws_fall_short():
    assert len(FALL_SHORT) <= 0.02 * len(DRAWS)


def test_a_draw_needs_no_other_and_no_two_are_alike():
    assert drawn(3, 7) == drawn(3, 7)
    assert len({str(drawn(seed, number)["surfaces"]) for seed in (3, 4) for number in range(20)}) == 40


def test_draws_reach_the_ends_of_their_ranges():
    scenes = [drawn(5, number) for number in range(300)]
    terms = [t for scene in scenes for s in scene["surfaces"] for t in _terms(s)]
    systems = [judged(scene) for scene in scenes]
    spots = [spot_extent(system) for system in systems]
    pixels = [mm(scene["detector"]["pixel"]) for scene in scenes]
    for values, low, high in (
        ([t["C"] for t in terms], 1.1, 7.9),
        ([mm(t["B"]) for t in terms], 0.0055, 90.0),
        ([system.wavelength for system in systems], 1.1e-6, 5.5e-4),
        ([system.obscuration for system in systems], 0.01, 0.94),
        ([spot / pixel for spot, pixel in zip(spots, pixels, strict=True)], 1e-3, 0.5 * PIXELS_ACROSS),
        ([spot / core_width(s) for spot, s in zip(spots, systems, strict=True)], 1e-3, 0.5 * CORES_ACROSS),
    ):
        assert min(values) < low
        assert max(values) > high
    assert max(spot / pixel for spot, pixel in zip(spots, pixels, strict=True)) < PIXELS_ACROSS
    assert max(spot / core_width(s) for spot, s in zip(spots, systems, strict=True)) < CORES_ACROSS
    assert min(spots) == 0.0


def _terms(surface):
    given = surface.get("psd", [])
    return given if isinstance(given, list) else [given]
