"""Made-up runs for the tests of the products: any positive numbers do, as long as nothing in them is symmetric."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from psfcli.image.grid import Detector
from psfcli.image.result import EnsquaredEnergy, FieldImage, Spot, SurfaceScatter
from psfcli.products.header import RunHeader
from psfcli.products.writer import FORMATS, ProductWriter
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.system import Field, Pupil, Telescope
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from pathlib import Path

AT_INFINITY = Telescope(95.0 / 1750.0, Pupil(0.48), SeidelTable(W131=-7.6 * 9.4e-6), math.radians(0.5), 1750.0)
FINITE = Telescope(0.05, Pupil(), SeidelTable(), 20.0, None)


def run_header(fields: int = 3, waves: tuple[float, ...] = (9.4e-6,), **changes: object) -> RunHeader:
    content = {
        "title": "Two mirrors",
        "wavelengths": waves,
        "specular_fractions": tuple(0.5 + 0.1 * i for i in range(len(waves))),
        "throughput": 0.9,
        "telescope": AT_INFINITY,
        "surfaces": tuple(
            SurfaceScatter(name, wave, 6.8e-7, 0.83, 0.56, 1750.0, 0.95) for wave in waves for name in ("one", "two")
        ),
        "fields": tuple(Field(math.radians(0.25 * i)) for i in range(fields)),
        "detector": Detector(0.021, 8, 3),
        "tolerance": Tolerance(1e-3, 1e-5),
        "config": "schema: 1\ntitle: Zwei Spiegel, 21 µm\n",
        "command": "psfcli run two.yaml",
        "input_name": "two.yaml",
        "input_sha256": "ab" * 32,
        "plan": {"method": "any"},
    }
    return RunHeader(**{**content, **changes})


def random_image(header: RunHeader, seed: int = 0) -> FieldImage:
    rng = np.random.default_rng(seed)
    pixels, oversample = header.detector.pixels, header.detector.oversample
    over = rng.random((pixels * oversample, pixels * oversample))
    over *= 0.8 / over.sum()
    psf = over.reshape(pixels, oversample, pixels, oversample).sum(axis=(1, 3))
    half_width = np.unique(np.r_[0.021 * 10.0 ** np.arange(-2.0, 3.01, 0.1), 0.021 * np.arange(1, pixels + 1) / 2.0])
    energies = [np.sort(rng.random(half_width.size)) for _ in range(4)]
    spot = Spot(1e-4, 2e-3, 0.0, 1e-3, 3e-3, 4e-3, -0.02, 0.02, -0.01, 0.03)
    reached = Tolerance(1e-4 * (1 + seed), 1e-6)
    return FieldImage(psf, over if oversample > 1 else None, spot, EnsquaredEnergy(half_width, *energies), 0.2, reached)


def write_run(directory: Path, header: RunHeader, formats: tuple[str, ...] = FORMATS, **options: bool) -> ProductWriter:
    with ProductWriter(directory, header, formats, **options) as products:
        for wave in range(len(header.wavelengths)):
            for field in range(len(header.fields)):
                products.add(wave, field, random_image(header, 100 * wave + field))
        products.timings = {"images": 0.1}
    return products
