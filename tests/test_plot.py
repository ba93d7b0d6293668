"""Pictures of a run: they are made of its files alone, show their numbers, and refuse what they cannot show."""

from __future__ import annotations

import gc
import json
import math
import shutil
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from click.testing import CliRunner
from matplotlib.figure import Figure
from product_scenes import FINITE, run_header, write_run

from psfcli.cli import main
from psfcli.image.grid import Detector
from psfcli.pictures.energy import EnergyCurve, energy_panel
from psfcli.pictures.psf import colour_bar, decades, density, psf_panel
from psfcli.pictures.run import Row, draw
from psfcli.products.reading import MOST_ROWS, read_rows
from psfcli.telescope.system import Field


def plot(*arguments):
    return CliRunner().invoke(main, ["plot", *map(str, arguments)])


def panel():
    return Figure().subplots()


@pytest.fixture(scope="module")
def products(tmp_path_factory):
    """A run of two wavelengths, the longer first, and three fields, with 8 x 8 pixels of 3 x 3 sub-pixels."""
    directory = tmp_path_factory.mktemp("place") / "two_psf"
    write_run(directory, run_header(waves=(1.31e-5, 9.4e-6)))
    return directory


# -- panels from plain arrays


def test_colours_are_the_density_of_the_cells():
    x, y = np.linspace(-4.0, 8.0, 7), np.linspace(0.0, 9.0, 4)  # cells of 2 x 3 um
    fraction = np.random.default_rng(1).random((3, 6))
    drawn = psf_panel(panel(), fraction, x, y, (1e3, 1e6), 6.0)
    np.testing.assert_allclose(drawn.get_array(), fraction / 6e-6, rtol=1e-14)  # 6 um^2 are 6e-6 mm^2
    assert drawn.get_extent() == [-4.0, 8.0, 0.0, 9.0]
    assert drawn.origin == "lower"
    assert (drawn.norm.vmin, drawn.norm.vmax) == (1e3, 1e6)


def test_all_light_is_the_integral_of_the_density():
    x = np.linspace(-10.0, 10.0, 9)
    fraction = np.full((8, 8), 1.0 / 64.0)
    assert density(fraction, x, x).sum() * (2.5e-3) ** 2 == pytest.approx(1.0, rel=1e-14)


def test_contours_of_a_round_image_are_circles_at_their_levels():
    x = np.linspace(-50.0, 50.0, 401)
    middle = 0.5 * (x[1:] + x[:-1])
    r2 = middle**2 + middle[:, None] ** 2
    axes = panel()
    psf_panel(axes, 0.25**2 * 1e-6 * 1e4 * np.exp(-r2 / 200.0), x, x, (1e-2, 1e4), 25.0)
    (lines,) = axes.collections
    assert list(lines.levels) == pytest.approx([10.0 ** (0.5 * i) for i in range(-3, 8)])
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        radius = np.hypot(*path.vertices.T)
        # linear interpolation between cells 0.25 um wide errs by no more than a twentieth of one
        np.testing.assert_allclose(radius, math.sqrt(-200.0 * math.log(level / 1e4)), atol=0.0125)


def test_the_grid_shows_the_edges_of_the_detector_pixels():
    axes = panel()
    x = np.linspace(-42.0, 42.0, 13)
    psf_panel(axes, np.ones((12, 12)), x, x, (1.0, 1e4), 21.0)
    assert [line.get_xdata()[0] for line in axes.lines[:3]] == pytest.approx([-21.0, 0.0, 21.0])
    assert len(axes.lines) == 6


def test_limits_are_whole_decades_about_the_light():
    assert decades([np.array([[0.0, 3.0]]), np.array([[0.2]])]) == pytest.approx((0.1, 10.0))
    assert decades([np.array([1e-30, 5e3])]) == pytest.approx((1e-2, 1e4))
    assert decades([np.array([1e2])]) == pytest.approx((10.0, 100.0))
    assert decades([np.zeros(3)]) == pytest.approx((0.1, 1.0))


def test_darkness_has_a_colour_and_the_bar_says_that_there_is_fainter():
    for fraction, extend in ((np.eye(3), "min"), (np.ones((3, 3)), "neither")):
        figure = Figure()
        axes, x = figure.subplots(), np.arange(4.0)
        drawn = psf_panel(axes, fraction, x, x, (1.0, 1e7), 1.0)
        assert not np.ma.is_masked(drawn.norm(drawn.get_array()))
        colour_bar(figure, [drawn])
        assert drawn.colorbar.extend == extend


def test_curves_are_the_energies_given():
    width = np.geomspace(1.0, 1e3, 7)
    curves = [EnergyCurve(f"{i}°", width, np.linspace(0.1 * i, 1.0, 7)) for i in range(3)]
    axes = panel()
    lines = energy_panel(axes, curves, EnergyCurve("none", width, np.sqrt(width / 1e3)), 21.0)
    for line, curve in zip(lines, curves, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), width)
        np.testing.assert_array_equal(line.get_ydata(), curve.energy)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), np.sqrt(width / 1e3))
    assert axes.lines[-1].get_xdata()[0] == 10.5  # half a pixel
    assert axes.get_xscale() == "log"
    assert axes.get_xlim() == pytest.approx((1.0, 1e3))
    assert axes.get_legend_handles_labels()[1] == ["none", "0°", "1°", "2°"]


def test_of_many_curves_all_are_drawn_and_two_named():
    width = np.geomspace(1.0, 1e3, 7)
    axes = panel()
    lines = energy_panel(axes, [EnergyCurve(f"{i}°", width, width / 1e3) for i in range(11)])
    assert len(lines) == 11
    assert axes.get_legend_handles_labels()[1] == ["0°", "10°"]


# -- what is read of the files


def test_rows_are_wavelengths_and_windows_the_middle_of_the_finest_cube(products):
    title, rows = read_rows(products, 1, (2, 4))
    assert title == "Two mirrors; images of 0.25°"
    assert [row.label for row in rows] == ["9.4 nm", "13.1 nm"]
    with fits.open(products / "psf.fits") as opened:
        for row, version in zip(rows, (2, 1), strict=True):
            for window, n in zip(row.windows, (2, 4), strict=True):
                part = slice(4 - n // 2, 4 + n // 2)
                fine = slice(3 * part.start, 3 * part.stop)
                np.testing.assert_array_equal(window.fraction, opened["PSF_OVER", version].data[1][fine, fine])
                blocks = window.fraction.reshape(n, 3, n, 3).sum(axis=(1, 3))
                np.testing.assert_allclose(blocks, opened["PSF", version].data[1][part, part], rtol=1e-12)
                np.testing.assert_allclose(window.x, np.linspace(-10.5 * n, 10.5 * n, 3 * n + 1), atol=1e-9)
                assert window.pixel == pytest.approx(21.0)


def test_curves_are_the_rows_of_the_table_for_every_wavelength_and_field(products):
    _, rows = read_rows(products, None, ())
    table = np.genfromtxt(products / "ee.csv", delimiter=",", names=True)
    for row, wave in zip(rows, (9.4, 13.1), strict=True):
        assert row.pixel == pytest.approx(21.0)
        for curve, field in zip(row.curves, (0.0, 0.25, 0.5), strict=True):
            mine = table[(table["wavelength_nm"] == wave) & (table["field"] == field)]
            np.testing.assert_array_equal(curve.half_width, mine["half_width_um"])
            np.testing.assert_array_equal(curve.energy, mine["ee"])
            assert curve.label == f"{field:g}°"
        first = table[(table["wavelength_nm"] == wave) & (table["field"] == 0.0)]
        np.testing.assert_array_equal(row.unaberrated.energy, first["ee_unaberrated"])


@pytest.mark.parametrize("oversample", [1, 3])
@pytest.mark.parametrize(
    ("pixels", "centre", "offset"),
    [(8, "middle", (0.0, 0.0)), (9, "middle", (0.002, -0.013)), (8, "pixel", (0.05, 0.0)), (8, "middle", (-9.0, 9.0))],
)
def test_windows_lie_where_the_world_coordinates_say(tmp_path, oversample, pixels, centre, offset):
    detector = Detector(0.021, pixels, oversample, centre, offset)
    write_run(tmp_path / "run", run_header(1, detector=detector), ("fits",))
    _, (row,) = read_rows(tmp_path / "run", 0, (3,))
    (window,) = row.windows
    with fits.open(tmp_path / "run" / "psf.fits") as opened:
        cube = opened["PSF_OVER" if oversample > 1 else "PSF"]
        plane, scale = cube.data[0], 1e3 * cube.header["CDELT1A"]
        # where the cells of the window are in the plane, found by their values, against astropy's coordinates of them
        (start_y,), (start_x,) = np.nonzero(plane == window.fraction[0, 0])
        np.testing.assert_array_equal(
            plane[start_y : start_y + 3 * oversample, start_x : start_x + 3 * oversample], window.fraction
        )
        x, y, _ = 1e3 * np.array(WCS(cube.header, key="A").all_pix2world(start_x, start_y, 0, 0))
    assert (window.x[0], window.y[0]) == pytest.approx((x - 0.5 * scale, y - 0.5 * scale), abs=1e-9)
    inside = all(abs(shift) < 1.0 for shift in offset)
    assert inside == all(edges[0] < 0.0 < edges[-1] for edges in (window.x, window.y))
    if inside:  # no window of whole pixels is nearer to the point
        assert max(abs(edges[0] + edges[-1]) for edges in (window.x, window.y)) <= 21.0 + 1e-9


def test_a_table_alone_gives_curves_alone(products, tmp_path):
    shutil.copytree(products, tmp_path / "csv", ignore=shutil.ignore_patterns("psf.*"))
    title, rows = read_rows(tmp_path / "csv", None, ())
    assert title == "Two mirrors"
    assert [row.windows for row in rows] == [(), ()]
    assert [curve.label for curve in rows[0].curves] == ["field 0", "field 0.25", "field 0.5"]  # deg or mm: untold
    _, whole = read_rows(products, None, ())
    for row, full in zip(rows, whole, strict=True):
        for curve, same in zip((*row.curves, row.unaberrated), (*full.curves, full.unaberrated), strict=True):
            np.testing.assert_array_equal(curve.energy, same.energy)


def test_heights_and_azimuths_are_named(tmp_path):
    fields = (Field(3.0), Field(3.0, math.radians(30.0)))
    write_run(tmp_path / "run", replace(run_header(), telescope=FINITE, fields=fields), ("fits",))
    title, (row,) = read_rows(tmp_path / "run", 1, (4,))
    assert title == "Two mirrors; images of field 3 mm at 30°"
    assert [curve.label for curve in row.curves] == ["field 3 mm at 30°", "field 3 mm"]  # as ee.csv sorts them


def test_of_many_wavelengths_the_first_the_last_and_some_between_are_rows(tmp_path):
    waves = tuple(1e-6 * (10.0 + i) for i in range(20))
    write_run(tmp_path / "run", run_header(1, waves=waves), ("csv",))
    _, rows = read_rows(tmp_path / "run", None, ())
    assert len(rows) == MOST_ROWS
    assert (rows[0].label, rows[-1].label) == ("10 nm", "29 nm")


# -- the sheet and the command


def test_the_picture_is_the_same_bytes_every_time_and_others_for_other_numbers(products):
    sheets = []
    for field in (2, 2, 1):
        draw(stream := BytesIO(), *read_rows(products, field, ()))
        sheets.append(stream.getvalue())
    assert sheets[0].startswith(b"\x89PNG\r\n")
    assert sheets[0] == sheets[1] != sheets[2]


def test_the_sheet_shows_every_window_and_every_curve(products, monkeypatch):
    figures = []
    monkeypatch.setattr(Figure, "suptitle", lambda self, *_, **__: figures.append(self))
    title, rows = read_rows(products, None, ())
    draw(BytesIO(), title, rows)
    images = [image for axes in figures[0].axes for image in axes.images]
    windows = [window for row in rows for window in row.windows]
    assert [image.get_array().shape for image in images] == [window.fraction.shape for window in windows]
    for image, window in zip(images, windows, strict=True):
        cell = 1e-3 * (window.x[1] - window.x[0])
        np.testing.assert_allclose(image.get_array(), window.fraction / cell**2, rtol=1e-12)
    panels = [axes for axes in figures[0].axes if axes.get_legend()]
    assert [len(axes.get_legend().get_texts()) for axes in panels] == [4, 4]


def test_the_picture_goes_where_it_is_told(products, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "place").mkdir()
    places = {
        (): "two_psf.png",
        ("-o", "mine.png"): "mine.png",
        ("-o", "place"): "place/two_psf.png",
        ("-o", "new/deep"): "new/deep/two_psf.png",
        ("-o", "new/other.png"): "new/other.png",
    }
    for options, place in places.items():
        finished = plot(products, *options)
        assert (finished.exit_code, finished.stdout, finished.stderr) == (0, f"{place}\n", "")
    contents = {(tmp_path / place).read_bytes() for place in places.values()}
    assert len(contents) == 1


def test_a_picture_that_stands_is_replaced_only_when_asked(products, tmp_path):
    file = tmp_path / "a.png"
    file.write_bytes(b"mine")
    refused = plot(products, "-o", file)
    assert (refused.exit_code, refused.stderr) == (4, f"{file}: exists already; --overwrite replaces it\n")
    assert file.read_bytes() == b"mine"
    assert plot(products, "-o", file, "--overwrite").exit_code == 0
    assert file.read_bytes().startswith(b"\x89PNG\r\n")
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_without_matplotlib_it_says_so(products, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    finished = plot(products, "-o", tmp_path / "a.png")
    assert finished.exit_code == 4
    assert finished.stderr == "no picture: matplotlib is missing; install it, or psfcli with its extra 'plot'\n"
    assert not list(tmp_path.iterdir())


def truncated(directory: Path) -> None:
    file = directory / "psf.fits"
    file.write_bytes(file.read_bytes()[:20000])


def cut_in_a_header(directory: Path) -> None:
    (directory / "psf.fits").write_bytes((directory / "psf.fits").read_bytes()[:5000])


def without(name: str):
    return lambda directory: (directory / name).unlink()


def foreign_table(directory: Path) -> None:
    (directory / "psf.fits").unlink()
    (directory / "ee.csv").write_text("a,b\n1,2\n")


def no_title(directory: Path) -> None:
    (directory / "manifest.json").write_text(json.dumps({"command": ""}))


def only_exr(directory: Path) -> None:
    (directory / "psf.fits").unlink()
    (directory / "ee.csv").unlink()


def emptied(directory: Path) -> None:
    for file in directory.iterdir():
        file.unlink()


@pytest.mark.parametrize(
    ("spoil", "options", "told"),
    [
        (emptied, (), "holds no products of psfcli run"),
        (without("manifest.json"), (), "holds an incomplete run (no manifest.json)"),
        (only_exr, (), "holds neither psf.fits nor ee.csv"),
        (truncated, (), "cannot be read: "),
        (cut_in_a_header, (), "cannot be read: "),
        (foreign_table, (), "cannot be read: ee.csv starts 'a,b'"),
        (no_title, (), "cannot be read: 'title'"),
        (without("psf.fits"), ("--field", "0"), "holds no psf.fits, and so no image"),
        (without("psf.fits"), ("--pixels", "4"), "holds no psf.fits, and so no image"),
        (lambda _: None, ("--field", "3"), "--field 3: the products hold the fields 0 to 2"),
        (lambda _: None, ("--pixels", "9"), "--pixels 9: the images have 8 x 8 pixels"),
        (lambda _: None, ("--pixels", "0"), "0 is not in the range x>=1"),
        (lambda _: None, ("--field", "-1"), "-1 is not in the range x>=0"),
        (lambda _: None, ("-o", "a.pdf"), "pictures are PNG"),
        (shutil.rmtree, (), "does not exist; give the directory that psfcli run wrote"),
    ],
)
def test_what_cannot_be_drawn_is_told_in_one_line(products, tmp_path, monkeypatch, spoil, options, told):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(products, tmp_path / "run")
    spoil(tmp_path / "run")
    before = sorted(tmp_path.rglob("*"))
    finished = plot("run", *options)
    gc.collect()  # a file left open would warn
    assert finished.exit_code == 2, finished.output
    last = finished.stderr.splitlines()[-1]
    assert told in last
    assert len(finished.stderr.splitlines()) == (1 if last.startswith("psfcli plot: ") else 4)  # or click's usage
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("place", ["taken", "taken/x.png"])
def test_a_picture_does_not_go_into_a_file(products, tmp_path, place):
    (tmp_path / "taken").write_text("mine")
    finished = plot(products, "-o", tmp_path / place)
    assert finished.exit_code == 4
    assert finished.stderr == f"{tmp_path / 'taken'}: is a file, not a directory; choose another --output\n"
    assert (tmp_path / "taken").read_text() == "mine"


def test_a_file_is_no_directory_of_products(products):
    finished = plot(products / "psf.fits")
    assert finished.exit_code == 2
    assert "is a file; give the directory that psfcli run wrote" in finished.stderr


def test_a_row_may_hold_no_window():
    width = np.geomspace(1.0, 1e3, 7)
    curve = EnergyCurve("0°", width, width / 1e3)
    draw(stream := BytesIO(), "", [Row("9.4 nm", (), (curve,), curve, 21.0)])
    assert stream.getvalue().startswith(b"\x89PNG\r\n")
