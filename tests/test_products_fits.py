from __future__ import annotations

import dataclasses
import hashlib
import shutil
import subprocess
import sys

import numpy as np
import pytest
from astropy import units
from astropy.io import fits
from astropy.wcs import WCS
from product_scenes import FINITE, random_image, run_header, write_run

from psfcli.image.grid import Detector
from psfcli.products.checksum import folded, word_sum
from psfcli.products.writer import ProductWriter
from psfcli.tolerance import Tolerance

TWO_WAVES = (9.4e-6, 17.1e-6)


def test_every_extension_is_found_by_name_with_its_shape(tmp_path):
    header = run_header(waves=TWO_WAVES)
    write_run(tmp_path, header)
    with fits.open(tmp_path / "psf.fits") as hdus:
        names = ["PRIMARY", "PSF", "PSF_OVER", "PSF", "PSF_OVER", "FIELDS", "EE", "SURFACES", "CONFIG"]
        assert [hdu.name for hdu in hdus] == names
        assert hdus["PSF", 2].data.dtype == np.dtype(">f8")
        assert hdus["PSF", 1].shape == (3, 8, 8)
        assert hdus["PSF_OVER", 2].shape == (3, 24, 24)
        for wave in (0, 1):
            for field in range(3):
                image = random_image(header, 100 * wave + field)
                assert np.array_equal(hdus["PSF", wave + 1].data[field], image.psf)
                assert np.array_equal(hdus["PSF_OVER", wave + 1].data[field], image.psf_over)
        assert bytes(hdus["CONFIG"].data).decode() == header.config


def test_without_oversampling_there_is_no_oversampled_cube(tmp_path):
    write_run(tmp_path, run_header(detector=Detector(0.021, 8)))
    with fits.open(tmp_path / "psf.fits") as hdus:
        assert "PSF_OVER" not in hdus
        assert hdus["PSF"].header["OVERSAMP"] == 1


def test_cards_tell_the_wavelength_the_scale_and_the_errors(tmp_path):
    header = run_header(waves=TWO_WAVES)
    write_run(tmp_path, header)
    with fits.open(tmp_path / "psf.fits") as hdus:
        cards = hdus["PSF_OVER", 2].header
        assert (cards["WAVELEN"], cards["FOCALLEN"], cards["OVERSAMP"], cards["SPECFRAC"]) == (1.71e-8, 1750.0, 3, 0.6)
        # 7 um seen from 1750 mm
        assert cards["PIXELSCL"] == pytest.approx((0.007 / 1750.0 * units.rad).to_value(units.arcsec), rel=1e-14)
        assert (cards["ACCPIX"], cards["ACCEE"]) == (1e-3, 1e-5)
        # the largest of the fields: random_image estimates 1e-4 (1 + seed)
        assert cards["ERRPIX"] == 1e-4 * 103
        assert cards["ERREE"] == 1e-6
        assert cards["CONFSHA"] == hashlib.sha256(header.config.encode()).hexdigest()
        assert cards["CREATOR"].startswith("psfcli ")
        assert (hdus[0].header["APERTURE"], hdus[0].header["OBSCURE"]) == (190.0, 0.48)
        assert not [key for hdu in hdus for key in hdu.header if "DATE" in key]


def test_an_unknown_error_is_told_as_larger_than_any(tmp_path):
    header = run_header(fields=2)
    with ProductWriter(tmp_path, header, ("fits",)) as products:
        for field, error in enumerate((1e-4, np.nan)):
            products.add(0, field, dataclasses.replace(random_image(header), reached=Tolerance(error, 1e-6)))
    assert fits.getheader(tmp_path / "psf.fits", "PSF")["ERRPIX"] == 1e99
    assert_verified(tmp_path / "psf.fits")


@pytest.mark.parametrize("telescope", [None, FINITE], ids=["at infinity", "finite"])
@pytest.mark.parametrize("pixels", [8, 9])
@pytest.mark.parametrize("centre", ["middle", "pixel"])
def test_the_gaussian_image_point_is_the_origin_and_the_next_row_is_up(tmp_path, centre, pixels, telescope):
    detector = Detector(0.021, pixels, 3, centre, (0.0063, -0.0042))
    header = run_header(fields=1, detector=detector, **({"telescope": telescope} if telescope else {}))
    write_run(tmp_path, header, ("fits",))
    # 0-based, before the shift of (0.3, -0.2) pixels; "pixel" is index N // 2
    still = (pixels - 1) / 2.0 if centre == "middle" else pixels // 2
    with fits.open(tmp_path / "psf.fits") as hdus:
        for name, oversample in (("PSF", 1), ("PSF_OVER", 3)):
            x, y = ((still + 0.5 - shift) * oversample - 0.5 for shift in (0.3, -0.2))
            for key, unit in ((" ", "mm"),) if telescope else ((" ", "arcsec"), ("A", "mm")):
                wcs = WCS(hdus[name].header, key=key)
                step = 0.021 / oversample
                if unit == "arcsec":
                    step = (step / 1750.0 * units.rad).to_value(units.arcsec)
                assert [str(u) for u in wcs.wcs.cunit][:2] == [unit, unit]
                assert np.allclose(wcs.pixel_to_world_values(x, y, 0), 0.0, atol=1e-12)
                assert np.allclose(wcs.pixel_to_world_values(x, y + 1, 0), (0.0, step, 0.0), atol=1e-12)
                assert np.allclose(wcs.pixel_to_world_values(x + 1, y, 0), (step, 0.0, 0.0), atol=1e-12)


def test_tables_have_the_units_and_numbers_they_claim(tmp_path):
    header = run_header()
    write_run(tmp_path, header)
    with fits.open(tmp_path / "psf.fits") as hdus:
        table = hdus["FIELDS"]
        assert table.data["field"].tolist() == [0.0, 0.25, 0.5]
        assert table.data["azimuth"].tolist() == [90.0] * 3
        assert table.data["centroid_y"].tolist() == [2.0] * 3
        assert table.data["rms_r"].tolist() == [5.0] * 3
        assert table.data["spot_y1"].tolist() == [30.0] * 3
        assert np.allclose(table.data["power_in_frame"], 0.8, rtol=1e-14)
        assert table.columns["centroid_x"].unit == "um"
        assert table.columns["field"].unit == "deg"
        surfaces = hdus["SURFACES"].data
        assert surfaces["name"].tolist() == ["one", "two"]
        assert (surfaces["wavelength"][0], surfaces["sigma_rel"][0], surfaces["d_j"][0]) == (9.4, 0.68, 1750.0)
        for hdu in hdus:
            for unit in [hdu.header[key] for key in hdu.header if key.startswith(("TUNIT", "BUNIT", "CUNIT"))]:
                units.Unit(unit, format="fits")


def test_columns_are_field_by_wavelength_when_there_are_several(tmp_path):
    write_run(tmp_path, run_header(waves=TWO_WAVES))
    assert fits.getdata(tmp_path / "psf.fits", "FIELDS")["centroid_x"].shape == (3, 2)


def test_fields_are_heights_at_finite_conjugates(tmp_path):
    header = run_header(telescope=FINITE)
    write_run(tmp_path, header)
    with fits.open(tmp_path / "psf.fits") as hdus:
        assert hdus["FIELDS"].columns["field"].unit == "mm"
        assert "PIXELSCL" not in hdus["PSF"].header


def test_ensquared_energy_is_the_same_in_fits_and_csv(tmp_path):
    write_run(tmp_path, run_header(waves=TWO_WAVES))
    text = (tmp_path / "ee.csv").read_text().splitlines()
    table = fits.getdata(tmp_path / "psf.fits", "EE")
    assert text[0].split(",") == table.columns.names
    assert [tuple(map(float, line.split(","))) for line in text[1:]] == [tuple(row) for row in table]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"waves": TWO_WAVES},
        {"telescope": FINITE},
        {"surfaces": ()},
        {"title": "Zwei »Spiegel« µm 'O''Neill' " + 40 * "lang\n"},
        {"detector": Detector(0.021, 7, 1)},
    ],
    ids=["plain", "waves", "finite", "no surface", "odd title", "odd size"],
)
def test_verifiers_find_nothing_to_say(tmp_path, changes):
    write_run(tmp_path, run_header(**changes), ("fits",))
    assert_verified(tmp_path / "psf.fits")


def assert_verified(path):
    script = "from astropy.io.fits.scripts.fitscheck import main; raise SystemExit(main())"
    check = subprocess.run(
        [sys.executable, "-c", script, "--compliance", str(path)], capture_output=True, text=True, check=False
    )
    assert check.returncode == 0, check.stdout + check.stderr
    if tool := shutil.which("fitsverify"):
        verdict = subprocess.run([tool, str(path)], capture_output=True, text=True, check=False)
        assert "0 warning(s) and 0 error(s)" in verdict.stdout, verdict.stdout


def test_a_sum_of_words_does_not_mind_the_order_of_bytes():
    values = np.random.default_rng(0).normal(size=1000)
    words = np.frombuffer(values.astype(">f8").tobytes(), ">u4").astype(object)
    assert word_sum(values) == sum(words)
    assert [folded(n) for n in (0, 1, 2**32 - 1, 2**32)] == [0, 1, 2**32 - 1, 1]


def test_photutils_gives_back_the_pixels(tmp_path):
    psf_models = pytest.importorskip("photutils.psf")
    write_run(tmp_path, run_header(detector=Detector(0.021, 9, 1)), ("fits",))
    psf = fits.getdata(tmp_path / "psf.fits", "PSF")[1].astype(float)
    model = psf_models.ImagePSF(psf)
    y, x = np.mgrid[-4:5, -4:5]
    assert np.allclose(model(x, y), psf, rtol=1e-12, atol=0.0)


def test_galsim_draws_the_oversampled_cube_onto_the_pixels(tmp_path):
    galsim = pytest.importorskip("galsim")
    write_run(tmp_path, run_header(detector=Detector(0.021, 8, 3)), ("fits",))
    with fits.open(tmp_path / "psf.fits") as hdus:
        scale, over = hdus["PSF_OVER"].header["PIXELSCL"], hdus["PSF_OVER"].data[1].astype(float)
        psf = hdus["PSF"].data[1].astype(float)
    fine = galsim.InterpolatedImage(galsim.Image(over, scale=scale), x_interpolant="nearest", normalization="flux")
    drawn = fine.drawImage(nx=24, ny=24, scale=scale, method="no_pixel", dtype=float).array
    blocks = drawn.reshape(8, 3, 8, 3).sum(axis=(1, 3))
    assert np.allclose(blocks, psf, rtol=1e-6, atol=0.0)
