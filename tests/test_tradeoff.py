"""What accuracy costs: the ladder keeps what was asked, the rivals' errors fall by their laws, the files say it all."""

import itertools
import json
import math
import runpy
import sys
import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner
from planned import CONFIGS, PAPER, WEDGE

import psfcli
from psfcli import recipe
from psfcli.cli import main
from psfcli.image.grid import Detector
from psfcli.tolerance import PRESETS, Tolerance
from psfcli.tradeoff import errors, ladder, rivals, table
from psfcli.tradeoff.measurement import Measurement, timed
from psfcli.tradeoff.plain_fft import plain_fft
from psfcli.tradeoff.rays import counted, pupil_grid, scattered_rays

DOCS = CONFIGS.parent / "docs"
SMALL = [
    "--set", "detector.pixels=8", "--set", "detector.oversample=2",
    "--set", "ensquared_energy={half_widths: [0.1 mm, 21 um, 42 um, 84 um]}",
]  # fmt: skip


@cache
def scene(config, *overrides, pixels=8):
    """The plan of the most demanding image, on a few pixels, and that image, far better than any rival here."""
    image = ladder.demanding(psfcli.load(config, [f"detector.pixels={pixels}", *overrides]))
    fine = recipe.plan(replace(image, tolerance=Tolerance(1e-5, 1e-7)))
    ((_, _, truth),) = recipe.images(fine)
    return fine, truth


def invoke(*arguments):
    return CliRunner().invoke(main, ["tradeoff", *map(str, arguments)])


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The command on a small scene: its outcome, its directory, and the measurements in its table."""
    directory = tmp_path_factory.mktemp("place") / "out"
    outcome = invoke(PAPER, *SMALL, "--max-seconds", "0.05", "-o", directory)
    with (directory / "tradeoff.csv").open() as stream:
        return outcome, directory, table.read_csv(stream)


# -- the command


def test_every_step_of_the_ladder_keeps_what_was_asked(done):
    outcome, _, measurements = done
    assert outcome.exit_code == 0, outcome.stderr
    ours = [m for m in measurements if m.method == ladder.OURS]
    assert [m.setting for m in ours] == ["1e-1", "draft", "1e-2", "standard", "1e-4", "1e-5", "reference"]
    for m in ours:
        assert m.true.pixel <= m.asked.pixel, m.setting
        assert m.true.ee <= m.asked.ee, m.setting
        assert m.met
    # the errors are real ones: they differ from 0 and fall by five decades with what is asked
    assert 0.0 < ours[-1].true.pixel < 1e-3 * ours[0].true.pixel
    assert 0.0 < ours[-1].true.ee < 1e-3 * ours[0].true.ee


def test_the_table_names_every_method_and_marks_what_is_extrapolated(done):
    outcome, directory, measurements = done
    assert {m.method for m in measurements} == {ladder.OURS, rivals.FFT, rivals.MONTE_CARLO, rivals.RAYS}
    assert [(m.method, m.setting) for m in measurements if m.extrapolated] == [(rivals.MONTE_CARLO, "1e9 rays")]
    assert "1e9 rays (extrapolated)" in outcome.stdout
    assert table.text_table(measurements) in outcome.stdout
    assert outcome.stdout.splitlines()[-2:] == [str(directory / name) for name in ("tradeoff.png", "tradeoff.csv")]
    assert "standard" in outcome.stderr
    for m in measurements:
        assert m.seconds > 0.0
        assert m.peak_memory > 0.0


def test_the_csv_has_its_columns_and_gives_the_measurements_back(done):
    _, directory, measurements = done
    text = (directory / "tradeoff.csv").read_text()
    assert text.splitlines()[0] == (
        "method,setting,asked_pixel,asked_ee,estimated_pixel,estimated_ee,pixel_error,ee_error,seconds,peak_memory_mb,"
        "extrapolated"
    )
    assert table.csv_text(measurements) == text


def test_the_picture_is_small_and_a_png(done):
    picture = (done[1] / "tradeoff.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n")
    assert len(picture) < 60_000


def test_a_tradeoff_that_stands_is_not_replaced_unasked(done):
    _, directory, _ = done
    before = sorted((p.name, p.read_bytes()) for p in directory.iterdir())
    refused = invoke(PAPER, *SMALL, "--quick", "-o", directory)
    assert refused.exit_code == 4
    assert refused.stderr == f"{directory}: already holds products; --overwrite replaces them\n"
    assert sorted((p.name, p.read_bytes()) for p in directory.iterdir()) == before


def test_without_matplotlib_there_is_a_table_and_no_old_picture(tmp_path, monkeypatch):
    (tmp_path / "tradeoff.png").write_bytes(b"of an earlier run")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    quick = invoke(
        CONFIGS / "perfect_mirrors.yaml",
        *SMALL,
        "--quick",
        "-q",
        "--max-seconds",
        "1e-9",
        "-o",
        tmp_path,
        "--overwrite",
    )
    assert quick.exit_code == 0
    assert quick.stderr == "no picture: matplotlib is missing; install it, or psfcli with its extra 'plot'\n"
    assert [p.name for p in tmp_path.iterdir()] == ["tradeoff.csv"]
    assert quick.stdout.splitlines()[-1] == str(tmp_path / "tradeoff.csv")
    with (tmp_path / "tradeoff.csv").open() as stream:
        assert {m.setting for m in table.read_csv(stream) if m.method == ladder.OURS} == set(PRESETS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.yaml"], "nowhere.yaml: no such file\n"),
        ([PAPER, "--field", "5"], '--field "5": fields[0]: 5 has no unit; write for example 5 deg\n'),
        ([PAPER, "--wavelength", "9"], '--wavelength "9": wavelengths[0]: 9 has no unit; write for example 9 nm\n'),
        ([PAPER, "--max-seconds", "nan"], "Error: Invalid value for '--max-seconds': nan is no number\n"),
        ([PAPER, "--max-seconds", "0"], "Error: Invalid value for '--max-seconds': 0.0 is not in the range x>0.0.\n"),
    ],
)  # fmt: skip
def test_wrong_input_is_told_before_anything_is_measured(tmp_path, arguments, message):
    refused = invoke(*arguments, "-o", tmp_path / "out")
    assert refused.exit_code == 2
    assert refused.stderr.endswith(message)
    assert not (tmp_path / "out").exists()


def test_a_place_that_cannot_be_written_is_told_before_anything_is_measured(tmp_path):
    (tmp_path / "file").write_text("")
    refused = invoke(PAPER, "-o", tmp_path / "file" / "out")
    assert refused.exit_code == 4
    assert len(refused.stderr.splitlines()) == 1


def test_more_memory_than_there_is_is_refused(tmp_path):
    huge = invoke(PAPER, "--set", "detector.pixels=16384", "--set", "detector.oversample=99", "-o", tmp_path / "out")
    assert huge.exit_code == 1
    assert "MB of memory" in huge.stderr
    assert not (tmp_path / "out").exists()


def test_the_most_demanding_image_has_the_shortest_wavelength_and_the_largest_spot():
    image = ladder.demanding(psfcli.load(CONFIGS / "euv_six_lines.yaml"))
    assert image.wavelengths == (pytest.approx(9.4e-6),)
    assert [math.degrees(field.radius) for field in image.fields] == [pytest.approx(0.5)]  # 11.2 um rms against 8.1


# -- the rivals


def test_light_folded_back_by_the_plain_fft_falls_with_the_period_as_the_wing_does():
    # one mirror, C = 2: the wing falls like r^-3, and so does what the copies of the image, a period apart, leave here
    small, truth = scene(CONFIGS / "one_rough_mirror.yaml", "detector.oversample=1")
    images = [plain_fft(small, size)[0] for size in (128, 256, 512, 1024)]
    # from size to size only the copies change: each step between the images is 7/8 of what the smaller folded back
    folded = [float((coarse - fine)[0, 0]) for coarse, fine in itertools.pairwise(images)]
    ratio = [a / b for a, b in itertools.pairwise(folded)]
    # the next order is 3 (window/period)^2, 1 % at the first period of 16 windows and a quarter of it at the next
    assert ratio == pytest.approx([8.0, 8.0], rel=0.01)
    assert folded[-1] > 1e-6 * truth.psf[0, 0]  # far above rounding


@pytest.mark.parametrize("config", ["wedge", "euv_two_mirror.yaml", "lens.yaml", "three_mirror.yaml"])
def test_monte_carlo_errs_as_counting_does(config, tmp_path):
    (tmp_path / "wedge").write_text(WEDGE)
    small, truth = scene(tmp_path / config if config == "wedge" else CONFIGS / config, pixels=9)
    for count in (20_000, 300_000):
        pixels, energies = counted(scattered_rays(small, count, seed=5), small.detector, small.half_widths)
        P = truth.psf
        square = (pixels - P) ** 2 / (P * (1.0 - P) / count)
        # the mean of 81 squares of unit variance, each of variance 2 + 1/(P count): within five standard errors of 1
        spread = math.sqrt(float(np.sum(2.0 + 1.0 / (P * count)))) / P.size
        assert float(np.mean(square)) == pytest.approx(1.0, abs=5.0 * spread)
        E = truth.ensquared.ee
        assert np.all(np.abs(energies - E) <= 5.0 * np.sqrt(E * (1.0 - E) / count) + 1.0 / count)


def test_a_regular_grid_of_rays_converges_faster_than_chance():
    small, truth = scene(CONFIGS / "perfect_mirrors.yaml", "detector.oversample=1")
    apart = []
    for edge in (50, 500):
        _, energies = counted(pupil_grid(small, edge**2), small.detector, small.half_widths)
        apart.append(float(np.max(np.abs(energies - truth.ensquared.ee))))
    assert apart[0] < 1.0 / 50  # at most the rays on the edge of a box are wrong, one of each fan
    assert apart[1] < 0.2 * apart[0]  # chance would leave a tenth of ten times fewer rays; a grid leaves less


def test_the_error_expected_of_rays_is_the_median_of_what_drawing_shows():
    _, truth = scene(PAPER, "detector.oversample=1")
    P = truth.psf
    free = ~errors.touched(truth.spot, Detector(0.021, 8))
    assert 0 < np.count_nonzero(free) < free.size
    count = 10**7
    generator = np.random.default_rng(3)
    drawn = generator.multinomial(count, np.append(P.ravel(), 1.0 - P.sum()), size=800)[:, :-1] / count
    largest = np.max(np.abs(drawn / P.ravel() - 1.0)[:, free.ravel()], axis=1)
    # the median of 800 draws is known to 0.05 of their spread of a quarter; the faintest pixel holds 2000 rays
    expected = errors.expected_pixel_error(count, truth, Detector(0.021, 8))
    assert expected == pytest.approx(float(np.median(largest)), rel=0.03)
    assert math.isnan(errors.expected_pixel_error(count, replace(truth, psf=0.0 * P), Detector(0.021, 8)))


def test_where_nothing_scatters_there_is_nothing_to_convolve():
    smooth, rough = (recipe.plan(psfcli.load(CONFIGS / name)) for name in ("perfect_mirrors.yaml", PAPER))
    assert [r.method for r in rivals.rivals(smooth)] == [rivals.MONTE_CARLO, rivals.RAYS]
    assert [r.method for r in rivals.rivals(rough)] == [rivals.FFT, rivals.MONTE_CARLO, rivals.RAYS]


def test_a_rival_beyond_the_limits_is_skipped_and_told():
    small, truth = scene(PAPER, "detector.oversample=1")
    told = []
    found = list(rivals.measured_rivals(small, truth, rivals.Limits(1e-9, 1e6, 1), told.append))
    # no memory for any FFT; of the rays only the first count, for which no time is known yet
    assert [(m.method, m.setting) for m in found if not m.extrapolated] == [
        (rivals.MONTE_CARLO, "1e4 rays"),
        (rivals.RAYS, "1e4 rays"),
    ]
    assert sum("skipped" in line for line in told) == 3


# -- how errors are told


def test_a_pixel_error_is_what_exceeds_the_allowance():
    truth = np.array([[0.1, 0.0], [1e-31, 1e-6]])
    allowance = np.array([[1e-3, 0.0], [0.0, 0.0]])
    assert errors.pixel_error(truth, truth, allowance) == 0.0
    for first, second, third, fourth, expected in (
        (0.9e-3, 0.0, 5e-31, 0.0, 0.0),  # within the allowance, and below the floor of the contract
        (3e-3, 0.0, 0.0, 0.0, 0.02),
        (0.0, 0.0, 0.0, -1e-7, 0.1),
        (0.0, 1e-20, 0.0, 0.0, math.inf),
    ):
        apart = np.array([[first, second], [third, fourth]])
        assert errors.pixel_error(truth + apart, truth, allowance) == pytest.approx(expected)


def test_light_touches_its_pixels_and_their_neighbours():
    _, truth = scene(PAPER, "detector.oversample=1")
    point = replace(truth.spot, x_min=0.001, x_max=0.002, y_min=0.022, y_max=0.043)
    mask = errors.touched(point, Detector(0.021, 8))
    assert np.argwhere(mask).min(axis=0).tolist() == [4, 3]  # rows 5 and 6, column 4
    assert np.argwhere(mask).max(axis=0).tolist() == [7, 5]


def test_an_accuracy_missed_shows_in_either_error():
    m = Measurement("psfcli", "x", Tolerance(1e-4, 1e-6), 1.0, 1.0, Tolerance(1e-3, 1e-5), Tolerance(1e-4, 1e-6))
    assert m.met
    assert replace(m, asked=None, estimated=None).met
    for wrong in (Tolerance(2e-3, 0.0), Tolerance(0.0, 2e-5)):
        assert not replace(m, true=wrong).met
        assert not replace(m, estimated=wrong).met


def test_time_and_memory_are_those_of_the_calculation():
    run = timed(lambda: np.ones(2_000_000).sum(), 3)
    assert run.answer == 2e6
    assert run.peak_memory == pytest.approx(16.0, abs=0.3)  # 8 bytes each
    assert 0.0 < run.seconds < 1.0


# -- what the documentation says


def test_every_system_has_its_measurements_and_a_small_picture():
    for config in CONFIGS.glob("*.yaml"):
        with (DOCS / "tradeoff" / f"{config.stem}.csv").open() as stream:
            found = {(m.method, m.setting) for m in table.read_csv(stream)}
        assert {(ladder.OURS, name) for name in ladder.rungs(presets_only=False)} <= found, config.stem
        assert (rivals.MONTE_CARLO, "1e7 rays") in found, config.stem
        picture = (DOCS / "tradeoff" / f"{config.stem}.png").read_bytes()
        assert picture.startswith(b"\x89PNG\r\n")
        assert len(picture) < 60_000, config.stem


def test_readme_docs_and_price_tags_are_made_from_the_measurements():
    figures = runpy.run_path(str(DOCS.parent / "scripts" / "figures.py"))
    pages = figures["pages"]()
    assert {path.name for path in pages} == {"README.md", "tradeoff.md", "prices.json"}
    for path, text in pages.items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: make figures, or scripts/figures.py pages"


@pytest.mark.parametrize("command", ["run", "plan"])
def test_the_help_tells_the_price_of_each_preset(command):
    told = " ".join(CliRunner().invoke(main, [command, "--help"], terminal_width=200).stdout.split())
    tags = json.loads((DOCS.parent / "psfcli" / "cli" / "prices.json").read_text())
    assert set(tags) == set(PRESETS)
    for name, tag in tags.items():
        assert f"{name} {tag['pixel_error']:.0e}, {tag['ee_error']:.0e}, x {tag['time']:g}" in told
    assert tags["standard"]["time"] == 1.0


def test_the_price_tags_are_part_of_the_package():
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text())
    assert "cli/prices.json" in project["tool"]["setuptools"]["package-data"]["psfcli"]
