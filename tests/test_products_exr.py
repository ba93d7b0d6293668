from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from astropy.io import fits
from product_scenes import random_image, run_header, write_run

from psfcli.image.grid import Detector
from psfcli.products.writer import ProductWriter


def read_by_openexr(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return [(part.name(), np.array(part.channels["Y"].pixels), dict(part.header)) for part in file.parts]


def read_by_openimageio(path):
    oiio = pytest.importorskip("OpenImageIO")
    opened = oiio.ImageInput.open(str(path))
    parts = []
    while opened.seek_subimage(len(parts), 0):
        spec = opened.spec()
        pixels = np.array(opened.read_image(len(parts), 0, 0, spec.nchannels, oiio.FLOAT))[:, :, 0]
        parts.append((spec.getattribute("oiio:subimagename"), pixels, {a.name: a.value for a in spec.extra_attribs}))
    opened.close()
    return parts


@pytest.mark.parametrize("read", [read_by_openexr, read_by_openimageio])
def test_every_part_is_the_fits_plane_with_its_largest_y_on_top(tmp_path, read):
    write_run(tmp_path, run_header(waves=(9.4e-6, 17.1e-6)))
    parts = read(tmp_path / "psf.exr")
    waves, fields = ("wave_00_", "wave_01_"), ("field_00", "field_01", "field_02")
    names = [f"{wave}{field}{over}" for over in ("", "_over") for wave in waves for field in fields]
    assert [name for name, _, _ in parts] == names
    with fits.open(tmp_path / "psf.fits") as hdus:
        for name, pixels, _ in parts:
            cube = hdus["PSF_OVER" if name.endswith("over") else "PSF", int(name[5:7]) + 1].data
            assert pixels.dtype == np.float32
            assert np.array_equal(pixels, cube[int(name[14:16])][::-1].astype(np.float32))


def test_attributes_are_text_and_say_where_the_centre_lies(tmp_path):
    header = run_header(detector=Detector(0.021, 8, 3, "pixel", (0.0, 0.0042)))
    write_run(tmp_path, header, ("exr",))
    attributes = {name: found for name, _, found in read_by_openexr(tmp_path / "psf.exr")}
    coarse, fine = attributes["field_01"], attributes["field_01_over"]
    assert (coarse["field"], coarse["wavelength"], coarse["pixel_um"]) == ("0.25 deg", "9.4 nm", "21.0")
    # index 4 of 8 from the left; the shift of +0.2 pixel moves it down, and 3.8 from the bottom is 3.2 from the top
    assert (coarse["centre_x"], coarse["centre_y"]) == ("4.0", "3.2")
    assert (fine["centre_x"], fine["centre_y"], fine["pixel_um"]) == ("13.0", "10.6", "7.0")
    assert float(fine["sum"]) == random_image(header, 1).psf_over.sum()


def test_one_field_more_than_a_file_holds_opens_the_next(tmp_path):
    header = run_header(fields=65, waves=(9.4e-6, 17.1e-6), detector=Detector(0.021, 4, 1))
    products = write_run(tmp_path, header, ("exr",))
    assert [p.name for p in products.paths] == ["psf_000.exr", "psf_001.exr", "manifest.json"]
    first, second = (read_by_openexr(tmp_path / f"psf_00{number}.exr") for number in (0, 1))
    assert len(first) == 128
    assert [name for name, _, _ in second] == ["wave_00_field_64", "wave_01_field_64"]
    assert np.array_equal(second[1][1], random_image(header, 164).psf[::-1].astype(np.float32))


def test_what_float32_cannot_hold_is_said(tmp_path):
    header = run_header(fields=1, detector=Detector(0.021, 8, 1))
    image = random_image(header)
    psf = image.psf.copy()
    psf[0, :3] = 1e-60
    psf[1, :2] = 1e-40
    psf[2, 0] = 0.0
    with ProductWriter(tmp_path, header) as products:
        products.add(0, 0, dataclasses.replace(image, psf=psf))
    (note,) = products.notes
    assert "5 of 63 positive values" in note
    assert "3 became 0, 2 lost digits" in note


def test_nothing_is_said_when_all_fits(tmp_path):
    assert write_run(tmp_path, run_header()).notes == ()


def test_openexr_is_loaded_only_when_asked_for(tmp_path):
    script = "import sys; from product_scenes import *; write_run(Path(sys.argv[1]), run_header(), ('fits', 'csv')); "
    done = subprocess.run(
        [sys.executable, "-c", f"from pathlib import Path; {script} print('OpenEXR' in sys.modules)", str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "False\n"
