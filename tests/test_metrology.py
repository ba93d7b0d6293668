"""Measured spectra: read or refused, fitted without bias, with intervals that hold, and named by a system file."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import integrate
from test_imports import loaded

from psfcli.cli import main
from psfcli.config import ConfigError, load
from psfcli.config.spectra import Stated, read_spectra, read_spectrum
from psfcli.metrology.coverage import gaps, image_band
from psfcli.metrology.fit import fit
from psfcli.metrology.measurement import KINDS, Measurement
from psfcli.metrology.resolution import FitError
from psfcli.metrology.roughness import band_rms, scattering
from psfcli.metrology.spectrum import k_correlations, log_density

ROOT = Path(__file__).resolve().parent.parent
SAMPLE = sorted((ROOT / "configs" / "metrology").glob("*.csv"))
PAPER = ROOT / "configs" / "euv_two_mirror.yaml"

A, B, C = 2.3e-13, 1.0, 1.8  # mm^3, mm
ONE_TERM = np.array([[math.log(A), math.log(B), C]])
TWO_TERMS = np.array([[math.log(1e-12), 0.0, 2.5], [math.log(1e-16), math.log(5e-3), 3.0]])
# kind, band [cycles/mm], points, periodograms averaged
INSTRUMENTS = (
    ("2d", 0.02, 2.0, 60, 4.0),
    ("1d one-sided", 0.5, 50.0, 60, 8.0),
    ("1d two-sided", 8.0, 800.0, 60, 3.0),
    ("2d", 200.0, 5e4, 80, 6.0),
)


def measured(terms, seed=None, gain=0.2, instruments=INSTRUMENTS):
    """What the instruments measure of a spectrum; gamma distributed and with gains, or exactly without a seed."""
    rng = np.random.default_rng(seed)
    found = []
    for i, (kind, low, high, points, averages) in enumerate(instruments):
        f = np.geomspace(low, high, points)
        density = np.exp(log_density(f, np.full(points, KINDS.index(kind)), terms)[0])
        if seed is not None:
            density *= rng.gamma(averages, 1.0 / averages, points) * math.exp(gain * rng.normal())
        found.append(Measurement(f"instrument {i}", kind, tuple(f.tolist()), tuple(density.tolist())))
    return found


@pytest.mark.parametrize("terms", [ONE_TERM, TWO_TERMS], ids=["one term", "two terms"])
def test_a_profile_sees_the_integral_of_the_plane(terms):
    # one-sided S1(f) = 2 int S2(sqrt(f^2 + g^2)) dg over all g: the kinds belong together
    def plane(f):
        return math.exp(log_density(np.array([f]), np.array([KINDS.index("2d")]), terms)[0][0])

    for f in (0.01, 1.0, 300.0):
        scale = max(f, 1.0)
        line = integrate.quad(
            lambda t, f=f, scale=scale: plane(math.hypot(f, math.tan(t) * scale)) * scale / math.cos(t) ** 2,
            0.0,
            math.pi / 2.0,
            epsabs=0.0,
            epsrel=1e-10,
            limit=500,
        )[0]
        for kind, share in (("1d one-sided", 4.0), ("1d two-sided", 2.0)):
            found = math.exp(log_density(np.array([f]), np.array([KINDS.index(kind)]), terms)[0][0])
            assert found == pytest.approx(share * line, rel=1e-8)


@pytest.mark.parametrize("kind", [None, *KINDS])
def test_spectra_without_noise_give_their_parameters_back(kind):
    instruments = [(kind or one[0], *one[1:]) for one in INSTRUMENTS]
    found = fit(measured(ONE_TERM, instruments=instruments))
    np.testing.assert_allclose(found.parameters, ONE_TERM, rtol=0.0, atol=1e-8)
    (term,) = found.spectra
    S0 = A * B * math.gamma((C + 1) / 2) / (2 * math.sqrt(math.pi) * math.gamma(C / 2))
    sigma = math.sqrt(2 * math.pi * S0 / ((C - 1) * B**2))
    assert term.sigma == pytest.approx(sigma, rel=1e-8)
    band = sigma * math.sqrt((1 + 0.5**2) ** ((1 - C) / 2) - (1 + 50.0**2) ** ((1 - C) / 2))
    assert band_rms(found, 0.5, 50.0).value == pytest.approx(band, rel=1e-8)
    assert all(abs(one.log_gain) < 1e-8 for one in found.instruments)


def test_two_terms_without_noise_are_told_apart():
    np.testing.assert_allclose(fit(measured(TWO_TERMS), terms=2).parameters, TWO_TERMS, rtol=0.0, atol=1e-8)


def test_95_percent_intervals_hold_the_truth_in_90_to_99_percent_of_200_seeds():
    # the chance of an exact interval to fall out of 90..99 % in 200 draws is 0.2 %
    distance = []
    for seed in range(200):
        found = fit(measured(ONE_TERM, seed))
        distance.append((found.parameters[0] - ONE_TERM[0]) / found.errors[0])
    inside = np.mean(np.abs(distance) < 1.96, axis=0)
    assert np.all((inside >= 0.90) & (inside <= 0.99)), inside
    assert np.all(np.abs(np.mean(distance, axis=0)) < 4.0 / math.sqrt(200.0))  # no bias beyond chance


def test_the_bias_of_the_logarithm_goes_with_its_scatter():
    # single periodograms: the logarithm alone would make the spectrum low by exp(-0.577) = 0.56
    instruments = [(*one[:3], 300, 1.0) for one in INSTRUMENTS]
    found = fit(measured(ONE_TERM, 5, gain=0.0, instruments=instruments), gain_error=0.0)
    assert abs(found.parameters[0, 0] - ONE_TERM[0, 0]) < 3.0 * found.errors[0, 0] < 0.4
    assert all(one.averages == pytest.approx(1.0, abs=0.3) for one in found.instruments)


def test_smoothed_spectra_are_given_wider_intervals():
    raw = measured(ONE_TERM, 8)
    kernel = np.ones(5) / 5.0
    smooth = [
        Measurement(
            m.name, m.kind, m.frequency[2:-2], tuple(np.exp(np.convolve(np.log(m.density), kernel, "valid")).tolist())
        )
        for m in raw
    ]
    found = fit(smooth)
    assert all(one.correlated > 2.0 for one in found.instruments)
    # five times fewer points in effect: errors about those of the raw spectra, not sqrt(5) below
    assert np.all(found.errors > 0.6 * fit(raw).errors)


def test_error_bars_are_those_of_the_parameters_drawn_at_random():
    found = fit(measured(ONE_TERM, 3))
    draws = np.random.default_rng(1).multivariate_normal(found.parameters.ravel(), found.covariance, 4000)
    for wavelength in (9.4e-6, 30.4e-6):
        scattered = scattering(found, wavelength)
        sigma = [k_correlations(d[None])[0] for d in draws]
        sigma = np.array([math.sqrt(t.band_variance(0.0, 1.0 / wavelength)) for t in sigma])
        tis = 1.0 - np.exp(-((4.0 * math.pi * sigma / wavelength) ** 2))
        for estimate, drawn in ((scattered.sigma_rel, sigma), (scattered.tis, tis)):
            low, high = np.quantile(drawn, (0.025, 0.975))
            # a quantile of 4000 draws is good to 4 % of half the interval; curvature adds a little
            assert estimate.low == pytest.approx(low, abs=0.08 * (high - low))
            assert estimate.high == pytest.approx(high, abs=0.08 * (high - low))
        assert 0.0 < scattered.tis.low < scattered.tis.value < scattered.tis.high < 1.0


def test_what_the_data_leave_open_is_refused_with_its_reason():
    every = measured(ONE_TERM, 1)
    with pytest.raises(FitError, match=r"no knee in the data: .* any B above 0\.\d+ mm fits"):
        fit(every[2:])
    with pytest.raises(FitError, match="no slope in the data"):
        fit(measured(np.array([[math.log(A), math.log(1e-3), C]]), 1)[:1])
    with pytest.raises(FitError, match="do not resolve 3 terms"):
        fit(every, terms=3)
    with pytest.raises(FitError, match=r"7 points; .* a file needs 8"):
        fit([Measurement("short", "2d", every[0].frequency[:7], every[0].density[:7])])


def test_the_band_of_an_image_less_what_is_measured():
    # physics.md: one 21 um pixel at f = 1750 mm and 9.4 nm is 1.28 cycles/mm
    low, high = image_band(0.021, 1.0, [9.4e-6], 1750.0)
    assert (low, high) == pytest.approx((1.2766, 60.79), rel=1e-4)
    assert gaps([(20.0, 30.0), (1.0, 10.0), (25.0, 40.0)], (5.0, 50.0)) == [(10.0, 20.0), (40.0, 50.0)]
    assert gaps([(1.0, 100.0)], (5.0, 50.0)) == []
    assert gaps([(60.0, 100.0)], (5.0, 50.0)) == [(5.0, 50.0)]


HEAD = "# kind: 2d\nf [1/mm],psd [nm4]\n"
GOOD_FILES = {
    "plain": HEAD + "1,4\n2,3\n",
    "unsorted": HEAD + "2,3\n1,4\n",
    "repeated rows": HEAD + "1,4\n2,3\n1,4\n",
    "mean and gaps": HEAD + "0,9\n1,4\n1.5,nan\n1.7,\n2,3\n",
    "semicolons": "# kind: 2-D\nf [1/mm];psd [nm^4]\n1;4;\n2;3;\n",
    "tabs": "# kind = 2D\nf (1/mm)\tpsd (nm4)\n1\t4\n2\t3\n",
    "blanks": "# kind: 2d\n# frequency unit: cycles/mm\n# psd_unit: nm4\n  1   4\n  2   3\n",
    "windows": (HEAD + "1,4\n2,3\n").replace("\n", "\r\n"),
    "byte order mark": "\ufeff" + HEAD + "1,4\n2,3\n",
    "quotes": '"kind: 2d"\n"f [1/mm]","psd [nm4]"\n"1","4"\n"2","3"\n',
    "other units": "# kind: 2d\nf [1/um],psd [um^4]\n1e-3,4e-12\n2e-3,3e-12\n",
    "comments": "% made today (or so)\n" + HEAD + "\n1,4\n# later\n2,3\n",
}
BAD_FILES = {
    "": "no numbers",
    HEAD: "no numbers",
    "f [1/mm],psd [nm4]\n1,2\n": "does not say which kind",
    "# kind: 1d\nf [1/mm],psd [nm3]\n1,2\n": "'1d' is unknown; allowed: 1d one-sided, 1d two-sided, 2d",
    "# kind: 2d\n1,2\n": "states no frequency unit",
    "# kind: 2d\n# frequency unit: 1/mm\n1,2\n": "states no psd unit",
    "# kind: 2d\nf [1/mm],psd [nm3]\n1,2\n": "is of dimension volume, not length^4",
    "# kind: 2d\nf [rad/mm],psd [nm4]\n1,2\n": "not spatial frequency",
    HEAD + "-1,2\n": ":3: frequency -1 is below 0",
    HEAD + "1,0\n": ":3: psd 0 is not above 0",
    HEAD + "1,-2\n": ":3: psd -2 is not above 0",
    HEAD + "1,inf\n": ":3: 'inf' is no finite number",
    HEAD + "1,1e999\n": ":3: '1e999' is no finite number",
    HEAD + "1,2,3\n": ":3: 3 values where frequency and psd are wanted",
    HEAD.replace(",", ";") + "1,5;2,5\n": "decimal commas are not read",
    HEAD + "0,2\n": "no point above f = 0",
    HEAD.replace("1/mm", "1/nm") + "1e6,2\n": "no band of a surface",
    "\0\1": "not text",
}


@pytest.mark.parametrize("text", GOOD_FILES.values(), ids=list(GOOD_FILES))
def test_a_spectrum_is_read_however_it_is_written(tmp_path, text):
    path = tmp_path / "map.csv"
    path.write_bytes(text.encode())
    found = read_spectrum(path)
    assert (found.name, found.kind, found.frequency) == ("map", "2d", pytest.approx((1.0, 2.0), rel=1e-14))
    assert found.density == pytest.approx((4e-24, 3e-24), rel=1e-14)


@pytest.mark.parametrize("text", BAD_FILES)
def test_a_bad_file_is_refused_with_one_line(tmp_path, text):
    path = tmp_path / "map.csv"
    path.write_bytes(text.encode())
    with pytest.raises(ConfigError) as caught:
        read_spectrum(path)
    assert BAD_FILES[text] in caught.value.faults[0]
    assert all(fault.startswith(str(path)) and fault.isprintable() for fault in caught.value.faults)


def test_files_that_are_no_text_or_not_there_are_told(tmp_path):
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    for name, says in (("binary", "is not UTF-8"), ("none", "no such file"), (".", "is a directory")):
        with pytest.raises(ConfigError, match=says):
            read_spectrum(tmp_path / name)


def test_the_mirrored_half_of_a_two_sided_spectrum_is_left_out(tmp_path):
    path = tmp_path / "scan.csv"
    path.write_text("f [1/mm],psd [nm3]\n-1,4\n0,7\n1,4\n")
    found = read_spectrum(path, Stated(kind="1d two-sided"))
    assert (found.frequency, found.density) == ((1.0,), pytest.approx((4e-18,)))


def test_points_at_one_frequency_are_no_spectrum():
    heap = Measurement("heap", "1d one-sided", (3.0,) * 20, tuple(1e-12 * n for n in range(1, 21)))
    with pytest.raises(FitError, match="all points lie at 3 cycles/mm"):
        fit([heap])


def test_two_files_of_one_instrument_need_names(tmp_path):
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "map.csv").write_text(HEAD + "1,4\n")
    with pytest.raises(ConfigError, match="2 files are of instrument 'map'"):
        read_spectra([tmp_path / "a" / "map.csv", tmp_path / "b" / "map.csv"])
    with pytest.raises(ConfigError, match="given twice"):
        read_spectra([SAMPLE[0], SAMPLE[0]])


def psf(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def paper_with(block, directory):
    """The paper's system with ``block`` as the psd of its primary, in ``directory``."""
    lines = PAPER.read_text(encoding="utf-8").splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("    psd:"))
    lines[at : at + 1] = ["    " + line for line in block.splitlines()]
    path = directory / "system.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize("terms", [1, 2])
def test_the_block_printed_says_what_the_files_say(tmp_path, monkeypatch, terms):
    monkeypatch.chdir(tmp_path)
    files = SAMPLE
    if terms == 2:
        files = []
        for m in measured(TWO_TERMS, 3, gain=0.05):
            files.append(tmp_path / f"{m.name}.csv")
            rows = "".join(f"{f!r},{p!r}\n" for f, p in zip(m.frequency, m.density, strict=True))
            files[-1].write_text(f"# kind: {m.kind}\nf [1/mm],p [{'mm4' if m.kind == '2d' else 'mm3'}]\n{rows}")
    answer = psf("fit-psd", *files, "--terms", terms, "-o", tmp_path / "out", "--wavelength", "9.4 nm")
    assert answer.exit_code == 0, answer.stderr
    assert "TIS" in answer.stderr
    assert f"# {tmp_path / 'out' / 'fit_psd.csv'}" in answer.stdout
    named = paper_with(f"psd: {{files: [{', '.join(map(str, files))}], terms: {terms}}}", tmp_path)
    system = load(named)
    pasted = load(paper_with(answer.stdout, tmp_path))
    assert system.surfaces == pasted.surfaces
    assert len(system.surfaces[0].psd) == terms
    effective = tmp_path / "effective.yaml"
    effective.write_text(system.text, encoding="utf-8")
    assert "files" not in system.text
    assert load(effective).surfaces == system.surfaces
    # the table holds what was read and fitted
    rows = [line.split(",") for line in (tmp_path / "out" / "fit_psd.csv").read_text().splitlines()]
    assert len(rows) == 1 + sum(len(one.frequency) for one in read_spectra(files))
    residuals = np.array([float(row[7]) for row in rows[1:]])
    assert abs(residuals.mean()) < 0.1


def test_the_sample_holds_what_it_was_made_from():
    found = fit(read_spectra(SAMPLE))
    truth = np.array([math.log(2.5285e-13), 0.0, 1.8])
    assert np.all(np.abs(found.parameters[0] - truth) < 3.0 * found.errors[0])


def test_an_image_in_a_band_that_nobody_measured_is_told(tmp_path):
    ends = [path for path in SAMPLE if path.stem in ("interferometer", "afm")]
    answer = psf("fit-psd", *ends, "--config", PAPER, "-o", tmp_path / "out")
    assert answer.exit_code == 0, answer.stderr
    assert "warning: surfaces[0] (primary): the detector" in answer.stderr
    assert "nobody measured 2..57.77 cycles/mm" in answer.stderr
    told = load(paper_with(f"psd: {{files: [{', '.join(map(str, ends))}]}}", tmp_path)).warnings
    assert len(told) == 1
    assert "nobody measured 2..57.77 cycles/mm" in told[0]


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["nowhere.csv"], 2, "nowhere.csv: no such file"),
        ([SAMPLE[0], "--wavelength", "9.4"], 2, "9.4 has no unit"),
        ([SAMPLE[0], "--kind", "1d"], 2, "'1d' is not one of"),
        ([SAMPLE[0], "--terms", "9"], 2, "1<=x<=4"),
        ([SAMPLE[0], "--no-offsets", "--gain-error", "0.1"], 2, "excludes"),
        ([SAMPLE[0], "--config", "nowhere.yaml"], 2, "nowhere.yaml: no such file"),
        ([SAMPLE[0], "--config", ""], 2, "'': no such file; a system file is wanted"),
        (["-", "--config", "-"], 2, "standard input (-) is one file: name the others"),
        ([""], 2, "'': no such file; a file of a spectrum is wanted"),
        ([SAMPLE[0], "--gain-error", "nan"], 2, "nan is no number"),
        ([SAMPLE[0], "--wavelength", "9 nm", "--wavelength", "x"], 2, "--wavelength \"x\": 'x' is not a number with"),
        ([SAMPLE[0]], 1, "no knee in the data"),
        ([], 2, "Missing argument"),
    ],
)
def test_a_wrong_command_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, options, code, says):
    monkeypatch.chdir(tmp_path)
    answer = psf("fit-psd", *options)
    assert (answer.exit_code, answer.stdout) == (code, "")
    assert says in answer.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("block", "says"),
    [
        ("{files: [none.csv]}", "32:10: surfaces[0].psd: {directory}/none.csv: no such file"),
        ("{files: []}", "32:18: surfaces[0].psd.files: a list of 0; allowed: 1..100 values"),
        ("{files: [a.csv], B: 1 mm}", "32:27: surfaces[0].psd.B: a key of convention harvey, scatmech, zemax"),
        ("{files: [a.csv], terms: 9}", "32:34: surfaces[0].psd.terms: 9 is out of range; allowed: 1..4"),
    ],
)
def test_a_fault_of_measured_files_is_told_where_they_stand(tmp_path, block, says):
    with pytest.raises(ConfigError) as caught:
        load(paper_with(f"psd: {block}", tmp_path))
    assert any(says.format(directory=tmp_path) in fault for fault in caught.value.faults), caught.value.faults


def test_a_second_fit_needs_overwrite(tmp_path):
    for more, code in ([], 0), ([], 4), (["--overwrite", "-q"], 0):
        answer = psf("fit-psd", *SAMPLE, "-o", tmp_path, *more)
        assert answer.exit_code == code
    assert answer.stderr == ""


def test_without_matplotlib_the_missing_picture_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    answer = psf("fit-psd", *SAMPLE, "-q", "-o", tmp_path / "out")
    assert answer.exit_code == 0
    assert answer.stderr == "no picture: matplotlib is missing; install it, or psfcli with its extra 'plot'\n"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["fit_psd.csv"]


def test_a_system_file_without_measured_spectra_loads_no_arrays(tmp_path):
    assert not loaded(tmp_path, "check", str(PAPER)) & {"numpy", "scipy"}
    assert not loaded(tmp_path, "fit-psd", "--help") & {"numpy", "scipy", "matplotlib"}
