from __future__ import annotations

import dataclasses
import io
import math
import subprocess
import sys

import numpy as np
import pytest
from product_scenes import random_image, run_header, write_run

from psfcli.image.grid import Detector
from psfcli.image.result import EnsquaredEnergy
from psfcli.products.tables import CsvProduct
from psfcli.products.units import DEG, NM, UM, converted
from psfcli.products.writer import ProductWriter
from psfcli.telescope.system import Field

HEADER = "wavelength_nm,field,azimuth_deg,half_width_um,width_px,ee,ee_chief,ee_centroid,ee_unaberrated"


def rows_of(path):
    lines = (path / "ee.csv").read_text().splitlines()
    assert lines[0] == HEADER
    return [tuple(map(float, line.split(","))) for line in lines[1:]]


@pytest.mark.parametrize(
    ("kept", "factor", "printed"),
    [
        (9.4e-6, NM, "9.4"),
        (0.021, UM, "21.0"),
        (math.radians(0.3), DEG, "0.3"),
        (0.0105, UM, "10.5"),
        (-0.0, UM, "0.0"),
    ],
)
def test_a_conversion_leaves_no_round_off(kept, factor, printed):
    assert repr(converted(kept, factor)) == printed


def test_rows_are_sorted_however_the_run_goes(tmp_path):
    fields = tuple(Field(math.radians(a), math.radians(z)) for a, z in ((0.5, 90), (0.0, 90), (0.5, 30), (-0.25, 90)))
    write_run(tmp_path, dataclasses.replace(run_header(waves=(17.1e-6, 9.4e-6)), fields=fields))
    rows = rows_of(tmp_path)
    assert [r[:4] for r in rows] == sorted(r[:4] for r in rows)
    assert {r[0] for r in rows} == {9.4, 17.1}
    assert {r[1:3] for r in rows} == {(-0.25, 90.0), (0.0, 90.0), (0.5, 30.0), (0.5, 90.0)}


def test_rows_are_written_as_soon_as_all_before_them_are():
    header = run_header(fields=4)
    stream = io.BytesIO()
    table = CsvProduct(stream, header)
    seen = []
    for field in (1, 0, 3, 2):
        table.add(0, field, random_image(header, field))
        fields = [float(line.split(",")[1]) for line in stream.getvalue().decode().splitlines()[1:]]
        seen.append(list(dict.fromkeys(fields)))
    assert seen == [[], [0.0, 0.25], [0.0, 0.25], [0.0, 0.25, 0.5, 0.75]]


def test_no_row_comes_twice(tmp_path):
    header = run_header(fields=2)
    header = dataclasses.replace(header, fields=(header.fields[1], header.fields[1]))
    widths = np.array([0.021, 0.0105, 0.021, 0.021 * (1 + 2e-16)])
    energies = np.array([0.4, 0.2, 0.4, 0.4])
    boxes = EnsquaredEnergy(widths, energies, energies, energies, energies)
    with ProductWriter(tmp_path, header, ("csv",)) as products:
        for field in (0, 1):
            products.add(0, field, dataclasses.replace(random_image(header), ensquared=boxes))
    assert rows_of(tmp_path) == [(9.4, 0.25, 90.0, 10.5, 1.0, *[0.2] * 4), (9.4, 0.25, 90.0, 21.0, 2.0, *[0.4] * 4)]


def test_every_float_is_given_back_by_its_text(tmp_path):
    header = run_header(fields=1)
    write_run(tmp_path, header, ("csv",))
    boxes = random_image(header).ensquared
    rows = np.array(rows_of(tmp_path))
    assert np.array_equal(rows[:, 5:], np.c_[boxes.ee, boxes.ee_chief, boxes.ee_centroid, boxes.ee_unaberrated])
    assert np.allclose(rows[:, 3], boxes.half_width * 1e3, rtol=1e-14)
    assert np.allclose(rows[:, 4], 2.0 * boxes.half_width / 0.021, rtol=1e-14)


def test_a_table_needs_no_cube(tmp_path):
    header = run_header(fields=1, detector=Detector(0.021, 8, 3))
    with ProductWriter(tmp_path, header, ("csv",)) as products:
        products.add(0, 0, dataclasses.replace(random_image(header), psf=None, psf_over=None))
    assert [p.name for p in products.paths] == ["ee.csv", "manifest.json"]


def test_a_table_alone_loads_neither_astropy_nor_openexr(tmp_path):
    script = (
        "import sys; from pathlib import Path; from product_scenes import *;"
        "write_run(Path(sys.argv[1]), run_header(), ('csv',));"
        "assert not {'astropy.io.fits', 'OpenEXR', 'scipy'} & set(sys.modules)"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "out")]
    subprocess.run(command, check=True, env={"PYTHONPATH": ":".join(sys.path)})
