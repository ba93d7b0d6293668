"""The products of a real run, opened by the programs they are for."""

import csv
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from click.testing import CliRunner

from psfcli.cli import main

TELESCOPE = Path(__file__).parent / "truth" / "reference" / "euv_field05.yaml"
PIXEL_MM, PIXELS, OVERSAMPLE = 0.021, 32, 3  # as the file says


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The directory of a run of two fields and two wavelengths."""
    directory = tmp_path_factory.mktemp("clients") / "out"
    options = ["--accuracy", "standard", "--set", "wavelengths=[9.4 nm, 17.1 nm]"]
    command = ["run", str(TELESCOPE), "-o", str(directory), *options, "--field", "0 deg", "--field", "0.5 deg"]
    finished = CliRunner().invoke(main, command)
    assert finished.exit_code == 0, finished.output
    return directory


@pytest.fixture(scope="module")
def planes(run):
    """{(name, wavelength, field): pixels}, as native doubles."""
    with fits.open(run / "psf.fits") as hdus:
        return {
            (name, wave, field): np.ascontiguousarray(hdus[name, wave].data[field], dtype=float)
            for name in ("PSF", "PSF_OVER")
            for wave in (1, 2)
            for field in (0, 1)
        }


def test_astropy_finds_light_world_coordinates_and_tables(run):
    with fits.open(run / "psf.fits") as hdus:
        fields = Table.read(hdus["FIELDS"])
        for wave in (1, 2):
            cube = hdus["PSF", wave]
            np.testing.assert_allclose(
                cube.data.sum(axis=(1, 2)) + fields["power_outside"][:, wave - 1], 1.0, atol=2e-5
            )  # `standard`: 1e-5 for each
            x, y, _ = WCS(cube.header, key="A").pixel_to_world_values(0, 0, 0)
            assert (x, y) == pytest.approx([-(PIXELS - 1) / 2.0 * PIXEL_MM] * 2, rel=1e-12)  # rounding
            # at 0.5 deg, in um to the digits known of the spot
            assert (fields["centroid_y"][1, wave - 1], fields["chief_y"][1, wave - 1]) == pytest.approx(
                (2.568, 0.949), abs=6e-4
            )
        assert Table.read(hdus["SURFACES"])["TIS"][0] == pytest.approx(0.5645, abs=5e-5)  # four digits


def test_ensquared_energy_is_one_table_in_csv_and_fits(run):
    table = fits.getdata(run / "psf.fits", "EE")
    with (run / "ee.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == table.columns.names
    assert [tuple(map(float, row)) for row in rows] == [tuple(row) for row in table]


def test_fitscheck_and_fitsverify_find_nothing(run):
    script = "from astropy.io.fits.scripts.fitscheck import main; raise SystemExit(main())"
    check = subprocess.run(
        [sys.executable, "-c", script, "--compliance", str(run / "psf.fits")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert check.returncode == 0, check.stdout + check.stderr
    if tool := shutil.which("fitsverify"):
        verdict = subprocess.run([tool, str(run / "psf.fits")], capture_output=True, text=True, check=False)
        assert "0 warning(s) and 0 error(s)" in verdict.stdout, verdict.stdout


def test_photutils_gives_back_the_pixels(planes):
    models = pytest.importorskip("photutils.psf")
    y, x = np.mgrid[:PIXELS, :PIXELS]
    for wave, field in ((1, 0), (1, 1), (2, 1)):
        psf = planes["PSF", wave, field]
        model = models.ImagePSF(psf, flux=1.0, x_0=(PIXELS - 1) / 2.0, y_0=(PIXELS - 1) / 2.0)
        np.testing.assert_allclose(model(x, y), psf, rtol=1e-12)  # splines pass through their points, to rounding


def test_galsim_sums_the_oversampled_image_to_the_pixels(planes, run):
    galsim = pytest.importorskip("galsim")
    n = PIXELS * OVERSAMPLE
    scale = fits.getheader(run / "psf.fits", "PSF_OVER")["PIXELSCL"]
    for wave, field in ((1, 1), (2, 0)):
        image = galsim.Image(planes["PSF_OVER", wave, field], scale=scale)
        light = galsim.InterpolatedImage(image, x_interpolant="nearest", normalization="flux")
        assert light.flux == pytest.approx(planes["PSF", wave, field].sum(), rel=1e-12)
        drawn = light.drawImage(nx=n, ny=n, scale=scale, method="no_pixel", dtype=float).array
        blocks = drawn.reshape(PIXELS, OVERSAMPLE, PIXELS, OVERSAMPLE).sum(axis=(1, 3))
        np.testing.assert_allclose(blocks, planes["PSF", wave, field], rtol=1e-6)  # its own flux and scale, in doubles


def test_openimageio_reads_every_part_as_fits_in_single_precision(planes, run):
    oiio = pytest.importorskip("OpenImageIO")
    opened = oiio.ImageInput.open(str(run / "psf.exr"))
    names = []
    while opened.seek_subimage(len(names), 0):
        spec = opened.spec()
        pixels = np.array(opened.read_image(len(names), 0, 0, spec.nchannels, oiio.FLOAT))[:, :, 0]
        name = spec.getattribute("oiio:subimagename")
        names.append(name)
        _, wave, _, field, *over = name.split("_")
        plane = planes["PSF_OVER" if over else "PSF", int(wave) + 1, int(field)]
        assert np.array_equal(pixels, plane[::-1].astype(np.float32))  # top row: largest y
        assert float(spec.getattribute("sum")) == pytest.approx(plane.sum(), rel=1e-12)
    opened.close()
    assert len(set(names)) == len(planes)
