"""The surface functions at the extremes: psfcli against exact values, and the formulas one would write first beside it.

Prints the points tried, the worst error in units of the allowed one and the values that are not finite, for each
function and region; then how whole images depart from their limits; and writes docs/extremes.md (about a minute).
``--tables`` first makes the exact values in tests/extremes/ anew
(mpmath; ten minutes on two processes, nearly all for the BSDF).
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import fft, interpolate, special

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "extremes.md"
sys.path.insert(0, str(ROOT / "tests"))

import limit_scenes as limits  # noqa: E402
from extremes import grid, judge  # noqa: E402
from promise import kept, truth_of  # noqa: E402

import psfcli  # noqa: E402
from psfcli import recipe  # noqa: E402
from psfcli.image.result import FieldImage  # noqa: E402


def plain_autocovariance(u: float, nu: float) -> tuple[float, float]:
    """The autocovariance rho and 1 - rho as they stand in the books."""
    rho = 2.0 ** (1.0 - nu) / special.gamma(nu) * np.float64(u) ** nu * special.kv(nu, u)
    return rho, 1.0 - rho


def plain_transfer(sigma: float, B: float, C: float, wavelength: float, r: float) -> tuple[float, float, float]:
    """sigma_rel, TIS and H likewise: exp(-g) times exp(g rho)."""
    K2 = np.float64(4.0 * math.pi / wavelength) ** 2
    variance = np.float64(sigma) ** 2 * (1.0 - (1.0 + np.float64(B / wavelength) ** 2) ** (0.5 * (1.0 - C)))
    g = K2 * variance
    rho, _ = plain_autocovariance(2.0 * math.pi * r / B, 0.5 * (C - 1.0))
    g_rho = np.minimum(g, K2 * np.float64(sigma) ** 2 * rho)
    return np.sqrt(variance), 1.0 - np.exp(-g), np.exp(-g) * np.exp(g_rho)


def plain_bsdf(beta: float, sigma: float, B: float, C: float, wavelength: float) -> tuple[float]:
    """FFTLog of exp(-g) [exp(g rho) - 1], 4096 points over 20 decades."""
    log_r = np.linspace(math.log(B * 1e-10), math.log(B * 1e10), 4096)
    step = log_r[1] - log_r[0]
    K2 = (4.0 * math.pi / wavelength) ** 2
    g = K2 * sigma**2 * (1.0 - (1.0 + (B / wavelength) ** 2) ** (0.5 * (1.0 - C)))
    rho = plain_autocovariance(2.0 * math.pi * np.exp(log_r) / B, 0.5 * (C - 1.0))[0]
    h = np.exp(-g) * (np.exp(K2 * sigma**2 * np.where(np.isfinite(rho), rho, 1.0)) - 1.0)
    offset = fft.fhtoffset(step, mu=0.0)
    transform = fft.fht(h * np.exp(log_r), step, mu=0.0, offset=offset)
    wanted = math.log(2.0 * math.pi * beta / wavelength)
    spline = interpolate.CubicSpline(offset - log_r[::-1], transform)
    return (2.0 * math.pi * math.exp(-wanted) * float(spline(wanted)) / wavelength**2,)


PLAIN: dict[str, judge.Formula] = {
    "autocovariance": plain_autocovariance,
    "transfer": plain_transfer,
    "bsdf": plain_bsdf,
}
NAMES = {
    "rho": "rho", "complement": "1 - rho", "sigma_rel": "sigma_rel", "tis": "TIS", "transfer": "H", "bsdf": "BSDF",
}  # fmt: skip


class Outcome(NamedTuple):
    """How a formula did on one function in one region."""

    points: int
    excess: float  # the worst error in units of the allowed one, of the finite values
    relative: float  # the worst relative error, of the finite values
    wrong: int  # values beyond the allowed error, the next ones among them
    broken: int  # nan, infinite, negative, or 0 where it should not be

    @classmethod
    def of(cls, found: np.ndarray, exact: np.ndarray, units: np.ndarray) -> Outcome:
        """Count."""
        with np.errstate(all="ignore"):
            broken = ~np.isfinite(found) | (found < 0.0) | ((found == 0.0) != (exact == 0.0))
            relative = np.where(broken | (exact == 0.0), 0.0, np.abs(found / exact - 1.0))
        finite = np.where(broken, 0.0, units)
        return cls(exact.size, finite.max(), relative.max(), int(np.sum(units > 1.0)), int(broken.sum()))

    def told(self) -> str:
        """The worst relative error, and what has no error because it is no number."""
        return f"{self.relative:.1g}" + (f", {self.broken} of {self.points} broken" if self.broken else "")


Outcomes = dict[tuple[str, str, str], Outcome]


def outcomes(formulas: dict[str, judge.Formula]) -> Outcomes:
    """The outcome for each table, region and function."""
    results: Outcomes = {}
    for table, formula in formulas.items():
        rows = grid.rows(table)
        regions = np.array([row["region"] for row in rows])
        with np.errstate(all="ignore"):
            found = judge.evaluate(formula, table, rows)
        units = judge.errors(found, table, rows)
        for name, values in found.items():
            exact = judge.column(rows, name)
            for region in dict.fromkeys(regions):
                at = regions == region
                results[table, str(region), name] = Outcome.of(values[at], exact[at], units[name][at])
    return results


class Trap(NamedTuple):
    """What goes wrong in a plain formula, where it shows, and the cure."""

    what: str
    table: str
    region: str
    function: str
    formula: str
    cure: str


TRAPS = (
    Trap("1 - rho at small u", "autocovariance", "tiny distances", "complement", "1 - u^nu K_nu(u)...",
         "power series with A_0 = 1 left out: both terms, u^(2 nu) and u^2"),
    Trap("C near 3, 5, 7, ...", "autocovariance", "whole orders", "complement", "1 - u^nu K_nu(u)...",
         "terms with a common pole taken together: the logarithm at whole nu, and its neighbours"),
    Trap("u^nu K_nu(u) for large C", "autocovariance", "steep spectra", "rho", "2^(1-nu)/Gamma(nu) u^nu K_nu(u)",
         "the series in u^2/nu, and Debye's expansion in logarithms"),
    Trap("the tail", "autocovariance", "tail", "rho", "2^(1-nu)/Gamma(nu) u^nu K_nu(u)",
         "logarithms, with K_nu scaled by exp(u)"),
    Trap("u near 0 and infinity", "autocovariance", "outside the doubles", "complement", "1 - u^nu K_nu(u)...",
         "0 and 1 exactly"),
    Trap("C -> 1: rho", "autocovariance", "flat spectra", "complement", "1 - u^nu K_nu(u)...",
         "rho and 1 - rho each by its own sum"),
    Trap("C -> 1: roughness below 1/lambda", "transfer", "flat", "sigma_rel",
         "sigma [1 - (1 + (B/lambda)^2)^((1-C)/2)]^(1/2)", "expm1 of a log1p"),
    Trap("C -> 1: H", "transfer", "flat", "transfer", "exp(-g) exp(g rho)",
         "a rho - g or a s - a (1 - rho), whichever has the smaller factor"),
    Trap("TIS -> 0", "transfer", "smooth", "tis", "1 - exp(-g)", "expm1"),
    Trap("sigma below 1e-154 mm", "transfer", "smooth", "sigma_rel", "(sigma^2 ...)^(1/2)", "never by way of sigma^2"),
    Trap("TIS -> 1", "transfer", "rough", "transfer", "exp(-g) exp(g rho)", "exp(-g (1 - rho))"),
    Trap("steep and rough", "transfer", "steep", "transfer", "exp(-g) exp(g rho)", "all of the above"),
    Trap("the clip at the horizon", "transfer", "clip", "transfer", "exp(-g) exp(min(g, K^2 C))", "all of the above"),
    Trap("BSDF over many decades", "bsdf", "any slope", "bsdf", "FFTLog, 4096 points over 20 decades",
         "a mixture of Gaussians, read off on two rays"),
    Trap("g >> 1: a core whose width follows g", "bsdf", "closed form", "bsdf", "FFTLog, 4096 points over 20 decades",
         "the range of the mixture follows g"),
)  # fmt: skip

# what goes wrong in the image, the cure, and the test that holds it
IN_THE_IMAGE = (
    ("a core narrower than a pixel", "integrals over pixels, no samples at their centres",
     "test_composite.py::test_pixels_are_within_the_accuracy_asked_for"),
    ("energy", "the light outside by a road of its own",
     "test_composite.py::test_light_outside_the_window_is_what_the_window_lacks"),
    ("line focus", "integrals only", "test_geometric.py::test_a_line_focus_has_a_length_and_no_width"),
    ("no aberration", "the point on its pixel, or shared by four",
     "test_geometric.py::test_a_perfect_image_lies_on_a_pixel_or_is_shared_by_four"),
    ("obscuration -> 1", "thin rings",
     "test_geometric.py::test_finer_obscurations_make_thinner_rings_of_the_same_light"),
    ("float32 in EXR", "sums in doubles; what underflows is said",
     "test_products_exr.py::test_what_float32_cannot_hold_is_said"),
    ("h2/h1 -> 0", "the scatter joins the unscattered light",
     "test_physics.py::test_scatter_near_an_image_collapses_onto_the_specular_light"),
    ("BLAS threads", "one thread, work split by whole fields",
     "test_configs.py::test_two_runs_and_two_jobs_give_the_same_bytes"),
)  # fmt: skip

# the limit and the test that holds it
LIMITS = (
    ("C = 2, 3, 4, 6: closed forms, and C +- 1e-9", "test_extremes.py::test_closed_forms_and_their_neighbours"),
    ("C -> 1: the roughness is spread evenly over ln f", "test_extremes.py::test_C_to_1_is_a_logarithm"),
    ("C -> infinity: a Gaussian, reached like 1/C", "test_extremes.py::test_C_to_infinity_is_a_gaussian"),
    ("B -> 0: all roughness beyond the horizon", "test_extremes.py::test_a_knee_far_beyond_the_horizon"),
    ("B -> infinity: all below it", "test_extremes.py::test_a_knee_far_below_the_horizon"),
    ("g -> 0: first-order scatter", "test_extremes.py::test_smooth_surfaces_scatter_once"),
    ("g >> 1, C < 3: a stable law", "test_extremes.py::test_rough_surfaces_of_flat_spectra_tend_to_a_stable_law"),
    ("g >> 1, C > 3: the Gaussian of the slopes",
     "test_extremes.py::test_rough_surfaces_of_steep_spectra_tend_to_a_gaussian"),
    ("u -> 0 and u -> infinity", "test_extremes.py::test_the_ends_of_the_axis_are_exact"),
    ("the far wing: first order at any g",
     "test_physics.py::test_the_smooth_limit_is_g_times_the_spectrum_with_no_loss_factor"),
    ("equal mirrors: far wings like (h2/h1)^(C-1)",
     "test_physics.py::test_equal_mirrors_differ_in_the_far_wing_by_the_height_ratio_to_the_C_minus_1"),
    ("no roughness: the spot alone", "test_physics.py::test_without_roughness_the_image_is_the_geometrical_one"),
    ("no aberration: a point and the halo",
     "test_physics.py::test_without_aberration_the_image_is_a_point_and_the_halo"),
)  # fmt: skip

INTRODUCTION = """# The extremes of the surface functions, and of whole images

What goes wrong in the formulas one would write first, and what psfcli does instead. Made by `make extremes`, from
{points} exact values (mpmath) at arguments drawn at random: nu = (C-1)/2 from 1e-6 to 1000, u = 2 pi r/B from 0 to
1e300, phase variances g from 1e-300 to 1e6, B from 1 nm to 1 km, wavelengths from 0.1 nm to 1 mm. They lie in
`tests/extremes/`, and `tests/test_extremes.py` holds every one of them.

Allowed is a relative error of 1e-12 times max(1, nu/100, |ln rho|) for rho and 1 - rho, times max(1, |ln H|) for H; of
1e-12 for sigma_rel, TIS and a BSDF that has a closed form (C = 2, 4, 6, 8); of 1e-8 for any other BSDF. What lies below
the normal doubles is 0 exactly. A value is broken when it is no number, infinite, negative, or 0 where it should not be
(or not 0 where it should).
"""

IMAGES = """## Whole images at their limits

The paper's telescope on 8 x 8 pixels at one field, with other values, as `tests/test_limits.py` holds it. Asked for was
`standard`: 1e-3 of a pixel, 1e-5 of the light in a square; a pixel that unscattered light reaches may err by 1e-5 of
the light more.

Beside the limit: how far the images depart from the one at the limit, step by step.
"""

IMAGES_JUDGED = """At the limit: how far pixels and energies are from those of the judge of the tests
(`tests/truth/`: other formulas, and finer), and what the run told of its own error.
"""

IMAGES_REACHED = """Beyond what can be judged: what a run of the accuracy `draft` (3e-2, 1e-3) tells that it reached.
"""

REFUSED = """## What is refused

The BSDF goes through the mixture of Gaussians. Where that does not resolve a spectrum both steep and rough, and two
calculations by different steps disagree by more than 1e-8, it is an error that says so, never a wrong number. In the
core that begins near g = 15 for C = 8, g = 6 for C = 10, g = 3 for C = 12 and g = 0.8 for C = 14. Refused is g above
1000, too.

## What doubles do not hold

Within a few hundredths of the separation at which the clip of H sets in, K^2 C(r) and g are nearly equal, and doubles
lose 1e-14 (K sigma)^2 of H beside what is allowed: it counts for g above 100.
"""


def table(heads: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    """A table in Markdown."""
    lines = [heads, ("---",) * len(heads), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def departures() -> Iterator[tuple[object, ...]]:
    """Limit by limit: what varies, its values, and how far pixels and energies are from those at the limit."""
    for name, approach in limits.APPROACHES.items():
        limit = psfcli.run(limits.loaded(**approach.limit))
        apart = [limits.apart(psfcli.run(limits.loaded(**changes)), limit) for changes in approach.near]
        pixels, energies = (", ".join(map(_digit, column)) for column in zip(*apart, strict=True))
        yield name, f"{approach.what}: {', '.join(approach.values)}", pixels, energies


def judged() -> Iterator[tuple[object, ...]]:
    """Scene by scene: the true error of pixels and the told one, the same of energies."""
    for name, changes in limits.JUDGED.items():
        made = limits.scene(**changes)
        found = kept(made, 1e-3, truth_of(made))
        yield name, *map(_digit, (found.pixel, found.told.pixel, found.ee, found.told.ee))


def reached() -> Iterator[tuple[object, ...]]:
    """Enormous aberrations: the accuracy told, of pixels and energies, and the exit code of the command."""
    for factor in limits.FACTORS:
        (told,) = psfcli.run(limits.loaded(**limits.enormous(factor), **limits.DRAFT)).reached
        missed = told.pixel > 3e-2 or told.ee > 1e-3
        yield f"aberrations times {factor:g}", _digit(told.pixel), _digit(told.ee), 3 if missed else 0


def refused() -> Iterator[str]:
    """The scenes that no run gives an image of, and what is said of them."""
    for name, (changes, _) in limits.REFUSED.items():
        try:
            psfcli.run(limits.loaded(**changes))
        except recipe.SceneError as error:
            yield f'- {name}: "{re.sub(r"^at [^:]*: ", "", str(error))}"\n'
        else:
            raise AssertionError(f"{name}: was not refused")


def many_fields() -> str:
    """How energies of many fields depart from those of the fields turned half round, and from those of fields alone."""
    system = limits.loaded(**limits.MANY_FIELDS)
    energies = np.array([image.ensquared.ee[0] for image in _without_cubes(system)])
    chosen = range(0, limits.COUNT // 2, limits.COUNT // 8)
    alone = [_without_cubes(replace(system, fields=(system.fields[i],)))[0].ensquared.ee[0] for i in chosen]
    turned, apart = (float(np.abs(d).max()) for d in (energies - energies[::-1], energies[chosen] - alone))
    return (
        f"{limits.COUNT} fields in one file: the energy in a square of 10 um differs by at most {_digit(turned)}\n"
        f"from that of the field turned half round, and by {_digit(apart)} from that of {len(alone)} fields, each in a "
        "file of its own.\n"
    )


def _digit(error: float) -> str:
    """An error to one digit."""
    return f"{error:.0e}" if error else "0"


def _without_cubes(system: psfcli.System) -> list[FieldImage]:
    """The images of a system of one wavelength, field by field, energies alone."""
    images = {field: image for _, field, image in recipe.images(recipe.plan(system, with_cube=False))}
    return [images[field] for field in range(len(images))]


def images() -> list[str]:
    """The section of whole images."""
    return [
        IMAGES,
        table(("limit", "approached by", "pixels depart by", "energies depart by"), list(departures())),
        IMAGES_JUDGED,
        table(("scene", "error of pixels", "told", "error of energies", "told"), list(judged())),
        many_fields(),
        IMAGES_REACHED,
        table(("scene", "pixel error told", "energy error told", "exit code"), list(reached())),
        "Refused, with the reason (exit code 1):\n",
        "".join(refused()),
    ]


def page(ours: Outcomes, plain: Outcomes, images: list[str]) -> str:
    """docs/extremes.md."""
    traps = []
    for trap in TRAPS:
        key = trap.table, trap.region, trap.function
        name = NAMES[trap.function]
        traps.append((trap.what, name, f"`{trap.formula}`", plain[key].told(), ours[key].told(), trap.cure))
    regions = [
        (NAMES[name], region, o.points, f"{o.excess:.2g}", o.broken, f"{p.excess:.2g}", p.wrong, p.broken)
        for (_, region, name), o, p in ((key, ours[key], plain[key]) for key in ours)
    ]
    points = sum(o.points for o in ours.values())
    return "\n".join([
        INTRODUCTION.format(points=points),
        "## Traps, and their cures\n\nThe worst relative error in the region where the trap lies.\n",
        table(("trap", "function", "plain formula", "its worst error", "psfcli's", "cure"), traps),
        "## In the image\n",
        table(("trap", "cure", "held by"), [(a, b, f"`{c}`") for a, b, c in IN_THE_IMAGE]),
        "## Limits\n",
        table(("limit", "held by"), [(a, f"`{b}`") for a, b in LIMITS]),
        "## All regions\n\nThe worst error in units of the allowed one, of the values that are not broken.\n",
        table(("function", "region", "points", "psfcli", "broken", "plain", "beyond the allowed", "broken"), regions),
        *images,
        REFUSED,
    ])  # fmt: skip


def main() -> int:
    """Make, compare, print, write; 0 when every value is within what is allowed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", action="store_true", help="first compute the exact values anew")
    if parser.parse_args().tables:
        with ProcessPoolExecutor() as pool:
            for name in grid.COLUMNS:
                grid.make(name, lambda *arguments: list(pool.map(*arguments, chunksize=4)))
    ours, plain = outcomes(judge.PSFCLI), outcomes(PLAIN)
    print(f"{'function':10} {'region':20} points | psfcli: worst, broken | plain: worst, beyond, broken")
    for key, o in ours.items():
        p = plain[key]
        print(
            f"{NAMES[key[2]]:10} {key[1]:20} {o.points:6} | {o.excess:13.2g} {o.broken:8} "
            f"| {p.excess:12.2g} {p.wrong:7} {p.broken:7}"
        )
    everything = list(ours.values())
    print(
        f"{sum(o.points for o in everything)} points, worst error {max(o.excess for o in everything):.2g} of the "
        f"allowed one, {sum(o.broken for o in everything)} broken; plain: {sum(p.wrong for p in plain.values())} "
        f"beyond the allowed error, {sum(p.broken for p in plain.values())} of them broken"
    )
    at_limits = images()
    print("\n".join(at_limits))
    PAGE.write_text(page(ours, plain, at_limits), encoding="utf-8")
    return 1 if any(o.wrong for o in everything) else 0


if __name__ == "__main__":
    sys.exit(main())
