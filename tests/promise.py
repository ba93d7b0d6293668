"""What the product promises of one system file (accuracy as asked, errors as told), held against the quick judge."""

from __future__ import annotations

import math
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from truth.geometry import spot_moments
from truth.image import Image
from truth.random_systems import drawn
from truth.scenes import Scene, judged, mm, pixel_edges, window

import psfcli
from psfcli.recipe import SceneError
from psfcli.tolerance import Tolerance

ASKED = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  # relative, of pixels; energies are asked a hundred times finer
FLOOR = 1e-30  # below it a value is only not negative, and below it
# how exact the judge is (truth.image); nothing finer is held against the product
JUDGED_RELATIVE, JUDGED_ENERGY = 1e-8, 1e-9
NOTHING = 1e-13  # errors this small are no errors: the estimate need not see them


@dataclass(frozen=True)
class Pixel:
    """A pixel, or a sub-pixel if ``fine``: its true ``energy``, and whether unscattered light is near."""

    row: int
    column: int
    fine: bool
    energy: float
    lit: bool


@dataclass(frozen=True)
class Truth:
    """The judge's numbers of one scene; ``boxes`` by column of the table and box, ``outside`` the window."""

    pixels: tuple[Pixel, ...]
    boxes: dict[tuple[str, int], float]
    outside: float
    seconds: float


@dataclass(frozen=True)
class Kept:
    """One run: what was asked and told, and the true errors; ``faults`` are words for what must not be.

    ``pixel`` is the largest (|error| - allowance)/P over the judged pixels, as ERRPIX is told; ``ee`` the largest
    error of the judged energies, as ERREE is told. ``places`` are where. ``outside`` is the error of the light that
    misses the window, which is held to ``ee`` but is no energy of a square. Each is less the judge's own error.
    ``refused`` is why there is no image.
    """

    asked: Tolerance
    told: Tolerance
    pixel: float
    ee: float
    places: tuple[str, str]
    outside: float
    seconds: float
    refused: str = ""
    faults: tuple[str, ...] = field(default=())

    @property
    def short(self) -> tuple[str, ...]:
        """Which of the two accuracies the run says it missed: exit code 3 if any."""
        names = ("pixel", "ee")
        return tuple(n for n in names if getattr(self.told, n) > getattr(self.asked, n))

    @property
    def violations(self) -> tuple[str, ...]:
        """What breaks the promise."""
        found = list(self.faults)
        if self.outside > self.asked.ee and not self.short:
            found.append(f"outside: true {self.outside:.2e} > asked {self.asked.ee:.0e}")
        for name in () if self.refused else ("pixel", "ee"):
            asked, told, true = (getattr(part, name) for part in (self.asked, self.told, self))
            place = self.places[name == "ee"]
            if true > asked and not self.short:
                found.append(f"{name}: true {true:.2e} > asked {asked:.0e} at {place}, told {told:.1e}")
            if true > max(3.0 * told, NOTHING):
                found.append(f"{name}: true {true:.2e} > 3 x told {told:.1e} at {place}, asked {asked:.0e}")
        return tuple(found)


@dataclass(frozen=True)
class Draw:
    """What became of one random system file: a run per accuracy, and the judge's time."""

    number: int
    runs: tuple[Kept, ...]
    judge_seconds: float


def examined(seed: int, number: int, accuracies: tuple[float, ...] = ASKED) -> Draw:
    """The draw, run at every accuracy and held against the judge."""
    scene = drawn(seed, number)
    truth = truth_of(scene)
    return Draw(number, tuple(kept(scene, accuracy, truth) for accuracy in accuracies), truth.seconds)


def tolerance(accuracy: float) -> Tolerance:
    """What is asked for at ``accuracy``."""
    return Tolerance(accuracy, 0.01 * accuracy)


def truth_of(scene: Scene) -> Truth:
    """The judge's numbers of a scene of one wavelength and field.

    Pixels and sub-pixels: under the spot's centroid, at its edge, half-way to a far corner, at a far edge, in the
    corner; squares about all centres; the window's outside.
    """
    started = time.process_time()
    system, detector = judged(scene), scene["detector"]
    half_widths = [mm(w) for w in scene["ensquared_energy"]["half_widths"]]
    spot, whole = spot_moments(system), window(detector)
    extent = max(spot["rms_x"], spot["rms_y"])
    centroid = spot["centroid_x"], spot["centroid_y"]
    farthest = max(max(map(abs, whole)), max(half_widths) + max(map(abs, centroid)))
    reach = 1.5 * (farthest + max(map(abs, centroid)) + 10.0 * extent)
    image, bare = Image(system, reach), Image(system.but(seidel={}), reach)
    pixels = []
    for fine in (False, True)[: 1 + (detector["oversample"] > 1)]:
        for row, column in sorted(_places(detector, centroid, extent, fine=fine)):
            x, y = (pixel_edges(detector, i, axis, fine=fine) for i, axis in ((column, 0), (row, 1)))
            wide = (2.0 * x[0] - x[1], 2.0 * x[1] - x[0], 2.0 * y[0] - y[1], 2.0 * y[1] - y[0])
            pixels.append(Pixel(row, column, fine, image.energy((*x, *y)), image.touches(wide)))
    centres = {"ee": (0.0, 0.0), "ee_chief": (spot["chief_x"], spot["chief_y"]), "ee_centroid": centroid}
    boxes = {}
    for box, half_width in enumerate(half_widths):
        for column, centre in centres.items():
            alike = [c for c in centres if (c, box) in boxes and math.dist(centres[c], centre) <= 1e-12 * half_width]
            boxes[column, box] = boxes[alike[0], box] if alike else image.square(half_width, centre)
        boxes["ee_unaberrated", box] = bare.square(half_width)
    # beyond a horizon the model ripples about nought, and squares may hold more than all there is: told as all
    boxes = {place: min(energy, 1.0) for place, energy in boxes.items()}
    return Truth(tuple(pixels), boxes, 1.0 - image.energy(whole, JUDGED_ENERGY), time.process_time() - started)


def _places(detector: dict, centroid: tuple[float, float], extent: float, *, fine: bool) -> set[tuple[int, int]]:
    """(row, column) of what is judged."""
    x0, x1, y0, y1 = window(detector)
    count = detector["pixels"] * (detector["oversample"] if fine else 1)
    far = (x0 if centroid[0] > 0.5 * (x0 + x1) else x1), (y0 if centroid[1] > 0.5 * (y0 + y1) else y1)
    points = [
        centroid,
        (centroid[0] + 1.6 * extent, centroid[1] - 0.7 * extent),
        (0.5 * (centroid[0] + far[0]), 0.5 * (centroid[1] + far[1])),
        (far[0], centroid[1]),
        far,
    ]
    places = set()
    for x, y in points:
        row, column = ((v - low) / (high - low) * count for v, low, high in ((y, y0, y1), (x, x0, x1)))
        places.add((int(np.clip(row, 0, count - 1)), int(np.clip(column, 0, count - 1))))
    return places


def kept(scene: Scene, accuracy: float, truth: Truth) -> Kept:
    """The product run on ``scene`` at ``accuracy`` and held against ``truth``."""
    asked = tolerance(accuracy)
    started = time.process_time()
    with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings(record=True) as told_off:
        warnings.simplefilter("always")
        path = Path(directory) / "scene.yaml"
        path.write_text(yaml.safe_dump(scene))
        system = psfcli.load(path, tolerance=asked)
        try:
            result = psfcli.run(system)
        except SceneError as error:
            nothing = Tolerance(math.inf, math.inf)
            return Kept(asked, nothing, 0.0, 0.0, ("", ""), 0.0, time.process_time() - started, str(error))
    seconds = time.process_time() - started
    faults = [f"warning: {w.message} ({Path(w.filename).name}:{w.lineno})" for w in told_off]
    cubes = {False: result.psf[0, 0], True: None if result.psf_over is None else result.psf_over[0, 0]}
    for name, cube in (("psf", cubes[False]), ("psf_over", cubes[True])):
        if cube is not None and not (np.all(np.isfinite(cube)) and cube.min() >= 0.0):
            faults.append(f"{name}: {np.count_nonzero(~(cube >= 0.0))} negative or nan, least {np.nanmin(cube):.2e}")
    pixels = {}
    for p in truth.pixels:
        got, place = float(cubes[p.fine][p.row, p.column]), f"{'sub-' * p.fine}pixel [{p.row}, {p.column}]"
        if p.energy < FLOOR:
            if not 0.0 <= got <= FLOOR:
                faults.append(f"{place}: {got:.2e} where there is {p.energy:.2e}")
            continue
        judge = JUDGED_RELATIVE * p.energy + JUDGED_ENERGY * p.lit
        pixels[place] = max(0.0, abs(got - p.energy) - asked.ee * p.lit - judge) / p.energy
    table = result.ensquared_energy
    for column in ("ee", "ee_chief", "ee_centroid", "ee_unaberrated"):
        if not np.all((table[column] >= 0.0) & (table[column] <= 1.0)):
            faults.append(f"{column}: from {np.min(table[column]):.2e} to {np.max(table[column]):.17g}")
    energies = {
        f"{column} [{box}]": abs(float(table[column][box]) - energy) for (column, box), energy in truth.boxes.items()
    }
    outside = abs(float(result.fields["power_outside"][0]) - truth.outside)
    worst, farthest = (max(errors, key=errors.get) if errors else "" for errors in (pixels, energies))
    told = Tolerance(result.reached[0].pixel, result.reached[0].ee)
    return Kept(
        asked,
        told,
        pixels.get(worst, 0.0),
        max(0.0, energies[farthest] - JUDGED_ENERGY),
        (worst, farthest),
        max(0.0, outside - JUDGED_ENERGY),
        seconds,
        faults=tuple(faults),
    )
