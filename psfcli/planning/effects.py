"""Every effect of a scene in words and numbers: modelled or skipped, why, and what skipping it saves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from psfcli.image.collapse import collapse, is_collapsed
from psfcli.image.grid import Detector
from psfcli.image.scatter import clip_is_seen, scatter_term, term_shape
from psfcli.planning.displacement import Sensitivity
from psfcli.planning.sharing import Computation
from psfcli.planning.smoothness import Place, Smoothness
from psfcli.surface.harvey_shack import phase_variance
from psfcli.surface.surface import Surface
from psfcli.telescope.system import Telescope
from psfcli.tolerance import Tolerance


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect that is ``modelled`` or not, ``because`` of what skipping it would change.

    ``ee`` bounds that change of any ensquared energy asked for (absolute), ``pixel`` that of any pixel asked for
    (relative); inf: there is no bound, nan: the other has decided. ``saves`` is what skipping it does or would save.
    """

    name: str
    modelled: bool
    ee: float
    pixel: float
    because: str
    saves: str

    def report(self) -> dict[str, object]:
        """The effect as JSON holds it: no number stands where there is none."""
        numbers = {"ee": self.ee, "pixel": self.pixel}
        return {
            "effect": self.name,
            "state": "modelled" if self.modelled else "skipped",
            **{name: number for name, number in numbers.items() if math.isfinite(number)},
            "because": self.because,
            "saves": self.saves,
        }


def scatter_effects(
    surfaces: Sequence[Surface], telescope: Telescope, wavelength: float, smoothness: Smoothness, place: str
) -> Iterator[Effect]:
    """Each surface's scatter, each PSD term of it, and multiple scatter; ``place`` says at which wavelength."""
    changes = {term.place: term for term in smoothness.terms}
    first: dict[tuple[float, str], Place] = {}
    for j, surface in enumerate(surfaces):
        name, mine = f"scatter of {surface.name}{place}", [changes[j, i] for i in range(len(surface.psd))]
        if not mine:
            yield Effect(name, False, 0.0, 0.0, "perfectly smooth", "its transfer function")
        elif len(mine) > 1 and all(term.skipped for term in mine):
            yield Effect(name, False, *_sum(term.change for term in mine), "every term is skipped", "the surface")
        elif len(mine) > 1:
            g = phase_variance(surface, wavelength)
            yield Effect(name, True, -math.expm1(-g), math.inf, "scatters that share of the light", "nothing")
        for i, term in enumerate(mine):
            label = f"{name}, psd[{i}]" if len(mine) > 1 else name
            shape = term_shape(scatter_term(surface, surface.psd[i], telescope, wavelength))
            ee, pixel = term.change.ee, term.change.pixel
            if term.skipped:
                because = "smooth enough in every square" + (" and pixel asked for" if pixel > 0.0 else " asked for")
                yield Effect(label, False, ee, pixel, because, "a term of the mixture")
            elif shape in first:
                a, b = first[shape]
                because = f"same order and same lambda d/B as {surfaces[a].name}, psd[{b}]: variances add"
                yield Effect(label, False, 0.0, 0.0, because, "a term of the mixture")
            else:
                first[shape] = (j, i)
                because = "may move that much light" if math.isnan(pixel) else "lights pixels that little else lights"
                yield Effect(label, True, ee, pixel, because, "a term of the mixture")
    G = sum(phase_variance(surface, wavelength) for surface in smoothness.surfaces)
    twice = -math.expm1(-G) - G * math.exp(-G)
    because = "light scattered more than once, in the exponential of Eq. 29" if G else "nothing scatters"
    yield Effect(f"multiple scatter{place}", G > 0.0, twice, math.inf if G else 0.0, because, "nothing")


def reach_effects(
    surfaces: Sequence[Surface],
    telescope: Telescope,
    wavelength: float,
    reach: float,
    smallest: float,
    tolerance: Tolerance,
    place: str,
) -> Iterator[Effect]:
    """How far the ``surfaces`` that scatter spread light, and where their spectra end; ``place`` as above.

    ``reach`` [mm] is the farthest distance asked for, ``smallest`` [mm] the smallest sub-pixel or half width.
    """
    spread = []
    for surface in surfaces:
        if not surface.psd:
            continue
        d = telescope.magnified_distance(surface.marginal_height)
        moved = collapse(surface, telescope, wavelength).error(smallest)
        name, seen = f"spread of {surface.name}{place}", not is_collapsed(d, reach)
        if seen:
            spread.append(surface)
        because = f"lands within d_j = {d:.4g} mm" + ("" if seen else ", a point: joins the unscattered light")
        yield Effect(name, seen, moved, math.inf if seen else moved, because, "its terms of the mixture")
    name = f"horizon{place}"
    if not spread:
        yield Effect(name, False, 0.0, 0.0, "nothing scatters", "wide Gaussians")
        return
    seen, change = clip_is_seen(spread, telescope, wavelength, reach, tolerance)
    because = "the clip of H at 1/lambda " + ("may be seen far out" if seen else "takes too little to be seen")
    yield Effect(name, seen, change.ee, change.pixel if change.pixel < 1.0 else math.inf, because, "wide Gaussians")


def aberration_effects(sizes: Mapping[str, float], worth: Sensitivity, *, modelled: bool) -> Iterator[Effect]:
    """Each coefficient of the Seidel table by its displacement [mm], ``modelled`` if not zero."""
    together = sum(sizes.values())
    for name, size in sizes.items():
        if size == 0.0:
            yield Effect(f"aberration {name}", False, 0.0, 0.0, "zero", "nothing")
            continue
        change, because = worth.change(size), f"displaces light by up to {1e3 * size:.3g} um"
        crosses = together >= worth.clearance and worth.unscattered > 0.0
        ee, pixel = (max(change.ee, worth.unscattered), math.nan) if crosses else (change.ee, change.pixel)
        where = ", with the others across edges" if crosses else ""
        yield Effect(f"aberration {name}", modelled, ee, pixel, because + where, "nothing without the others")
    because = "all displace light to where it changes an image" if modelled else "no aberration matters: one ray is all"
    change = worth.change(together) if together else Tolerance(0.0, 0.0)
    yield Effect("rays", modelled, change.ee, change.pixel, because, "all tracing")


def image_effects(
    computations: Sequence[Computation], names: Sequence[str], wavelengths: Sequence[str]
) -> Iterator[Effect]:
    """Each wavelength and each field: computed, or had of another."""
    own = {computation.wavelength_index for computation in computations}
    for w, wavelength in enumerate(wavelengths):
        if w in own:
            yield Effect(f"wavelength {wavelength}", True, 1.0, math.inf, "asked for", "its images")
        else:
            because = f"nothing scatters: the images of {wavelengths[_stands_in(computations, w)]}"
            yield Effect(f"wavelength {wavelength}", False, 0.0, 0.0, because, "its images")
    first = [computation for computation in computations if computation.wavelength_index == min(own)]
    for computation in first:
        twins = list(dict.fromkeys((twin.field_index, twin.symmetry) for twin in computation.stands_for))
        original, by = twins[0]
        yield Effect(f"field {names[original]}", True, 1.0, math.inf, "asked for", "its image")
        for index, symmetry in twins[1:]:
            how = "" if symmetry == by else ", turned or mirrored"
            yield Effect(f"field {names[index]}", False, 0.0, 0.0, f"the image of {names[original]}{how}", "its image")


def _stands_in(computations: Sequence[Computation], w: int) -> int:
    """The wavelength whose images those of wavelength ``w`` are."""
    return next(c.wavelength_index for c in computations for twin in c.stands_for if twin.wavelength_index == w)


def grid_effects(detector: Detector, *, with_cube: bool, boxes: int, distance: float) -> Iterator[Effect]:
    """The cube, its sub-pixels, the squares, the light outside the window, and how far the halo goes."""
    n, m = detector.pixels, detector.oversample
    unasked = "no product asked for holds it"
    pixels = f"{n} x {n} pixels asked for" if with_cube else unasked
    yield Effect("cube", with_cube, *_all_or_nothing(with_cube), pixels, f"{n * n} pixels an image")
    finer = with_cube and m > 1
    because = f"{m} x {m} sub-pixels a pixel asked for" if finer else "1 sub-pixel a pixel" if with_cube else unasked
    yield Effect("oversampling", finer, *_all_or_nothing(finer), because, f"{(m * m - 1) * n * n} sub-pixels an image")
    squares = f"{boxes} squares asked for" if boxes else unasked
    yield Effect("ensquared energy", boxes > 0, *_all_or_nothing(boxes > 0), squares, "squares about three centres")
    outside = "checks the sum of the pixels" if with_cube else unasked
    yield Effect("light outside the window", with_cube, *_all_or_nothing(with_cube), outside, "its own transform")
    yield Effect(f"halo to {distance:.4g} mm", True, 1.0, math.inf, "the farthest pixel or square", "wide Gaussians")
    because = "no pixel and no square asked for lies there"
    yield Effect(f"halo beyond {distance:.4g} mm", False, 0.0, 0.0, because, "all Gaussians wider but three")


def _all_or_nothing(modelled: bool) -> tuple[float, float]:
    return (1.0, math.inf) if modelled else (0.0, 0.0)


def _sum(changes: Iterator[Tolerance]) -> tuple[float, float]:
    listed = list(changes)
    return sum(change.ee for change in listed), sum(change.pixel for change in listed)
