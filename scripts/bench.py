"""Speed as ratios taken in one run: psfcli against what one would do otherwise. ``make bench`` prints them all.

Every ratio is the median of paired repetitions; smaller is better for psfcli unless the line says otherwise. One BLAS
thread throughout.
"""

from __future__ import annotations

import hashlib
import json
import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import tempfile

# processes find bytecode, as that of an installed package; the first of each kind, which is not timed, writes it
BYTECODE = tempfile.TemporaryDirectory()
os.environ["PYTHONPYCACHEPREFIX"] = BYTECODE.name
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import fft

import psfcli
from psfcli import recipe
from psfcli.image.grid import Detector
from psfcli.image.point import WavelengthScatter, field_images, wavelength_scatter
from psfcli.image.result import FieldImage
from psfcli.planning.plan import Plan
from psfcli.tolerance import Tolerance
from psfcli.tradeoff.errors import pixel_error, promised_error
from psfcli.tradeoff.plain_fft import plain_fft, scattered_blur
from psfcli.tradeoff.rays import counted, scattered_rays

ROOT = Path(__file__).resolve().parent.parent
PAPER = ROOT / "configs" / "euv_two_mirror.yaml"
IMPORTS = "import click, yaml, numpy, scipy.special, astropy.io.fits, OpenEXR"


def seconds(task: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Time of one call, wall time unless told."""
    started = clock()
    task()
    return clock() - started


def ratio(
    ours: Callable[[], object],
    theirs: Callable[[], object],
    repetitions: int = 5,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, float, float]:
    """Median of ours/theirs over paired calls after one warm-up of each, and the two median times."""
    ours(), theirs()
    pairs = [(seconds(ours, clock), seconds(theirs, clock)) for _ in range(repetitions)]
    return (
        statistics.median(a / b for a, b in pairs),
        statistics.median(a for a, _ in pairs),
        statistics.median(b for _, b in pairs),
    )


def process(*arguments: str) -> None:
    """Run a command and wait; its output is dropped."""
    subprocess.run(arguments, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def shared_scatter(scene: Plan) -> WavelengthScatter:
    """What all fields of the first wavelength share."""
    return wavelength_scatter(
        scene.surfaces, scene.telescope, scene.wavelengths[0], scene.half_widths, scene.reach, scene.tolerance
    )


def all_fields(scene: Plan) -> Callable[[], list[FieldImage]]:
    """A call that computes the scatter and the fields of ``scene`` with everything the products hold."""

    def compute() -> list[FieldImage]:
        scatter, detector, tolerance = shared_scatter(scene), scene.detector, scene.tolerance
        return list(field_images(scene.telescope, scene.fields, scatter, detector, tolerance, with_cube=True))

    return compute


def against_fft_and_rays(*fields: str) -> None:
    """Fields of the paper's case, the first the one judged, against a plain FFT and against ray counting.

    Either computes once what fields share: we the scatter, the FFT its transfer function.
    """
    system = psfcli.load(PAPER, fields=fields)
    scene = recipe.plan(replace(system, tolerance=Tolerance(2e-3, 1e-4)))
    truth = all_fields(recipe.plan(replace(system, tolerance=Tolerance(1e-6, 1e-8))))()
    ours = all_fields(scene)
    ours_error = max(
        promised_error(image, exact, scene.detector, scene.tolerance).pixel
        for image, exact in zip(ours(), truth, strict=True)
    )
    # the FFT is judged away from the middle, where the size of its cells counts and not the period
    allowance = np.zeros_like(truth[0].psf)
    allowance[24:40, 24:40] = np.inf
    our_seconds = statistics.median([seconds(ours) for _ in range(15)])
    print(
        f"paper's case, {len(fields)} field(s) at pixel 2e-3, ee 1e-4: largest pixel error {ours_error:.1e}, "
        f"{1e3 * our_seconds:.1f} ms"
    )
    smallest = scene.detector.sub_pixels  # whose transforms take no time beside the rays
    rays = statistics.median([seconds(lambda: plain_fft(scene, smallest)) for _ in range(3)])
    errors, times = [], []
    for size in (1024, 2048, 4096, 8192):
        started = time.perf_counter()
        blur = scattered_blur(scene, size)
        shared, started = time.perf_counter() - started, time.perf_counter()
        pixels, _ = plain_fft(scene, size, blur)
        times.append(shared + len(fields) * (time.perf_counter() - started))
        errors.append(pixel_error(pixels, truth[0].psf, allowance))
        print(
            f"  plain 2-D FFT of {size}^2 (period {size * system.detector.sub_pixel:.1f} mm): "
            f"error {errors[-1]:.1e}, {times[-1] / our_seconds:.1f} times our time"
        )
    # the wings that fold back fall as a power of the period: to our error by that power
    doublings = max(0.0, math.log2(errors[-1] / ours_error) / math.log2(errors[-2] / errors[-1]))
    equal = len(fields) * rays + (times[-1] - len(fields) * rays) * 4.0**doublings
    print(
        f"  plain FFT of equal error, pixels alone: {equal / our_seconds:.3g} times our time "
        f"(extrapolated by {doublings:.1f} doublings)"
    )
    # it takes the light of a cell as evenly spread: finer cells, of as long a period, for squares of a few pixels
    cells, energy_errors = [1, 2, 4], []
    for finer in cells:
        oversample = finer * system.detector.oversample
        cut = replace(scene, detector=replace(scene.detector, oversample=oversample))
        _, energies = plain_fft(cut, finer * 1024)
        small = scene.half_widths < 3.0 * scene.detector.pixel
        energy_errors.append(float(np.max(np.abs(energies - truth[0].ensquared.ee)[small])))
    told = ", ".join(
        f"{e:.1e} at {1e3 * scene.detector.sub_pixel / n:.2g} um" for n, e in zip(cells, energy_errors, strict=True)
    )
    halvings = max(
        0.0, math.log2(energy_errors[0] / scene.tolerance.ee) / math.log2(energy_errors[-2] / energy_errors[-1])
    )
    print(
        f"  its energies err by {told}: of equal pixels and energies to {scene.tolerance.ee:.0e} as asked "
        f"{equal * 4.0**halvings / our_seconds:.3g} times our time (cells halved {halvings:.1f} times)"
    )
    monte_carlo = len(fields) * statistics.median(
        [seconds(lambda: counted(scattered_rays(scene, 10**6), scene.detector, scene.half_widths)) for _ in range(3)]
    )
    print(f"  1e9 Monte Carlo rays for each field (1e6 timed): {1e3 * monte_carlo / our_seconds:.3g} times our time")


def large_kernel() -> None:
    """One more field on 2559 x 2559 pixels against one rfft2 + irfft2 pair."""
    system = psfcli.load(PAPER, fields=["0.5 deg"])
    detector = Detector(system.detector.pixel, 2559, 1, "pixel")
    scene = recipe.plan(replace(system, detector=detector))
    scatter = shared_scatter(scene)
    size = fft.next_fast_len(2559, real=True)
    plane = np.random.default_rng(0).random((size, size))
    from psfcli.image.composite import composite_images
    from psfcli.image.geometric import geometrical_images

    def kernel() -> None:
        points = geometrical_images(scene.telescope, scene.fields[:1])
        list(composite_images(points, scatter.halo, detector, scene.tolerance))

    def pair() -> None:
        fft.irfft2(fft.rfft2(plane, workers=1), (size, size), workers=1)

    value, ours, theirs = ratio(kernel, pair)
    print(
        f"2559 x 2559 kernel of one more field / rfft2 + irfft2 of {size}^2: {value:.2f} ({ours:.3f} s, {theirs:.3f} s)"
    )


def whole_run() -> None:
    """A whole process against its imports, accuracies against each other, and a hundred fields against one."""
    psf = [sys.executable, "-m", "psfcli", "run", str(PAPER), "--overwrite", "-q"]
    with tempfile.TemporaryDirectory() as directory:
        out = ["-o", str(Path(directory) / "out")]
        value, ours, theirs = ratio(
            lambda: process(*psf, *out), lambda: process(sys.executable, "-c", IMPORTS), repetitions=7
        )
        print(f"psfcli run of the paper's case / importing its libraries: {value:.2f}  ({ours:.2f} s, {theirs:.2f} s)")
        value, ours, theirs = ratio(
            lambda: process(*psf, *out, "--accuracy", "reference"),
            lambda: process(*psf, *out, "--accuracy", "standard"),
            repetitions=3,
        )
        print(f"the paper's case at reference / standard accuracy: {value:.2f}  ({ours:.2f} s, {theirs:.2f} s)")
        hundred = ["--set", "fields={start: 0 deg, stop: 0.5 deg, count: 100}"]
        one = ["--field", "0.5 deg"]
        csv = ["--format", "csv"]
        value, ours, theirs = ratio(
            lambda: process(*psf, *out, *csv, *hundred), lambda: process(*psf, *out, *csv, *one), repetitions=3
        )
        print(f"100 fields / 1 field, --format csv: {value:.2f}  ({ours:.2f} s, {theirs:.2f} s)")
        process(*psf, *out, *hundred)
        products = [p.read_bytes() for p in sorted((Path(directory) / "out").iterdir())]

        def write_and_hash() -> None:
            for number, content in enumerate(products):
                (Path(directory) / f"copy{number}").write_bytes(content)
                hashlib.sha256(content).hexdigest()

        imports = statistics.median([seconds(lambda: process(sys.executable, "-c", IMPORTS)) for _ in range(3)])
        value, ours, theirs = ratio(lambda: process(*psf, *out, *hundred), write_and_hash, repetitions=3)
        print(
            f"100 fields, all products, beyond imports / writing and hashing the same bytes: "
            f"{(ours - imports) / theirs:.1f}  ({ours - imports:.2f} s, {theirs:.2f} s for "
            f"{sum(map(len, products)) / 1e6:.0f} MB)"
        )


def sweep() -> None:
    """Six fields in one process against six processes."""
    fields = [f"{0.1 * i:.1f} deg" for i in range(6)]
    psf = [sys.executable, "-m", "psfcli", "run", str(PAPER), "--overwrite", "-q"]
    with tempfile.TemporaryDirectory() as directory:
        together = [argument for field in fields for argument in ("--field", field)]
        value, ours, theirs = ratio(
            lambda: process(*psf, "-o", f"{directory}/all", *together),
            lambda: [process(*psf, "-o", f"{directory}/{i}", "--field", f) for i, f in enumerate(fields)],
            repetitions=3,
        )
        print(f"6 fields in one process / 6 processes one after the other: {value:.2f}  ({ours:.2f} s, {theirs:.2f} s)")


# scenes in which one rule each bites: overrides of the paper's case, its fields, and the products asked for
RING = [f"{{radius: 0.4 deg, azimuth: {azimuth} deg}}" for azimuth in range(0, 360, 30)]
SCENES: dict[str, tuple[list[str], list[str], dict[str, bool]]] = {
    "twelve fields around the axis": ([], RING, {}),
    "twelve fields around the axis, squares alone": ([], RING, {"with_cube": False}),
    "a secondary of 5 pm at 500 nm": (
        [
            "wavelengths=[500 nm]",
            "surfaces.0.psd={sigma: 20 nm, B: 1 mm, C: 1.8}",
            "surfaces.1.psd={sigma: 0.005 nm, B: 1 mm, C: 2.5}",
        ],
        ["0.5 deg"],
        {},
    ),
    "the same secondary, squares alone of a hundred fields": (
        [
            "wavelengths=[500 nm]",
            "surfaces.0.psd={sigma: 20 nm, B: 1 mm, C: 1.8}",
            "surfaces.1.psd={sigma: 0.005 nm, B: 1 mm, C: 2.5}",
            "fields={start: 0 deg, stop: 0.5 deg, count: 100}",
        ],
        [],
        {"with_cube": False},
    ),
    "smooth mirrors at six wavelengths": (
        ["wavelengths=[9.4 nm, 13 nm, 17 nm, 19 nm, 28 nm, 30 nm]", "surfaces.0.psd=[]", "surfaces.1.psd=[]"],
        ["0.5 deg"],
        {},
    ),
    "no aberrations, eleven fields": (
        ["telescope.seidel={reference_wavelength: 9.4 nm}", "fields={start: 0 deg, stop: 0.5 deg, count: 11}"],
        [],
        {},
    ),
}


def skipping() -> None:
    """What planning saves: processor time with nothing skipped or shared over that as planned, planning included."""
    for name, (overrides, fields, products) in SCENES.items():
        system = psfcli.load(PAPER, overrides, fields or None)

        def images(
            everything: bool, system: psfcli.config.System = system, products: dict[str, bool] = products
        ) -> Callable[[], None]:
            def compute() -> None:
                for _ in recipe.images(recipe.plan(system, everything=everything, **products)):
                    pass

            return compute

        scene = recipe.plan(system, **products)
        value, full, ours = ratio(images(True), images(False), clock=time.process_time)
        print(
            f"nothing skipped / as planned, {name}: {value:.2f}  ({full:.3f} s, {ours:.3f} s; "
            f"{len(scene.computations)} of {len(scene.wavelengths) * len(scene.fields)} images computed)"
        )

    def planned(*overrides: str, **products: bool) -> Callable[[], object]:
        system = psfcli.load(PAPER, overrides)
        return lambda: list(recipe.images(recipe.plan(system, **products)))

    value, full, ours = ratio(planned(), planned(with_cube=False), clock=time.process_time)
    print(f"all products / squares alone, the paper's case: {value:.2f}  ({full:.3f} s, {ours:.3f} s)")
    apart, alike = (planned(f"surfaces.1.marginal_height={height} mm") for height in (94.9, 95))
    value, full, ours = ratio(apart, alike, clock=time.process_time)
    print(f"mirrors at almost one distance / at one, whose terms are one: {value:.2f}  ({full:.3f} s, {ours:.3f} s)")


def thousand_fields() -> None:
    """The memory of a thousand fields of 64 x 64 pixels and as many times 25 sub-pixels."""
    many = "fields={start: 0 deg, stop: 0.5 deg, count: 1000}"
    # VmHWM: what the process alone took, for ru_maxrss counts what started it, too
    code = (
        "import resource, sys\nfrom psfcli.cli import main\ntry:\n    main(sys.argv[1:])\nexcept SystemExit:\n"
        "    mine = next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
        "    print(mine, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    with tempfile.TemporaryDirectory() as directory:
        run = ["run", str(PAPER), "-o", directory, "--set", many, "--format", "fits,csv", "-q", "--max-memory", "300MB"]
        done = subprocess.run([sys.executable, "-c", code, *run], capture_output=True, text=True, check=True)
        mine, workers = (float(kB) / 1e3 for kB in done.stdout.splitlines()[-1].split())
        plan = json.loads((Path(directory) / "manifest.json").read_text())["plan"]
    planned = f"{plan['jobs']} jobs; planned {1e-6 * plan['memory_bytes']:.0f} MB"
    print(
        f"1000 fields x 64 x 64, oversample 5, fits and csv within 300 MB: {mine:.0f} MB by the process, "
        f"{workers:.0f} MB by the largest of its workers ({planned})"
    )


if __name__ == "__main__":
    against_fft_and_rays("0.5 deg")
    against_fft_and_rays("0.5 deg", "0.25 deg", "0 deg")
    large_kernel()
    whole_run()
    sweep()
    skipping()
    thousand_fields()
