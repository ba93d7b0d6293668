"""What a run takes and is allowed to take: memory, processes, and the place it writes to."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest
from planned import PAPER, paper, planned

import psfcli
from psfcli import recipe
from psfcli.cli.plan import describe
from psfcli.image.grid import Detector
from psfcli.planning.resources import resources
from psfcli.products import rehearsal
from psfcli.products.rehearsal import writing_seconds

QUICK = ("--accuracy", "draft", "--set", "ensquared_energy={half_widths: [21 um]}")
# the command, and what the process it ran in took at most [kB]; ru_maxrss would count what started it, too
MEASURED = """
import sys
from psfcli.cli import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")), file=sys.stderr)
    sys.exit(end.code)
"""


def psf(directory, *arguments):
    command = [sys.executable, "-m", "psfcli", *map(str, arguments)]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False)


def peak(directory, fields):
    """The memory a run of so many fields took at most, and that of its plan [byte]; each image is 0.85 MB."""
    many = f"fields={{start: 0 deg, stop: 0.5 deg, count: {fields}}}"
    run = ["run", str(PAPER), "-o", str(directory), "--format", "fits,csv", "--jobs", "1", "-q", *QUICK, "--set", many]
    done = subprocess.run([sys.executable, "-c", MEASURED, *run], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    manifest = json.loads((directory / "manifest.json").read_text())
    return 1024.0 * float(done.stderr), manifest["plan"]["memory_bytes"]


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to tell the memory of a process")
def test_memory_does_not_grow_with_the_fields_and_is_what_the_plan_says(tmp_path):
    few, told_few = peak(tmp_path / "few", 4)
    many, told_many = peak(tmp_path / "many", 150)
    assert few <= told_few
    assert many <= told_many
    # 128 MB of cubes; a part of the file is mapped while it is hashed, 34 MB, and the tables grow
    assert many - few < 45e6
    assert (tmp_path / "many" / "psf.fits").stat().st_size > 125e6


@pytest.mark.parametrize("fields", [1, 7, 1000, 10_000])
def test_less_memory_means_fewer_fields_together_then_fewer_jobs(fields):
    detector = Detector(0.021, 64, 5)
    free = resources(detector, 20, fields, fields, 4, float("inf"))
    assert free.jobs == min(4, fields)
    tight = resources(detector, 20, fields, fields, 4, 0.999 * free.memory)
    assert tight.memory <= free.memory
    assert (tight.jobs, tight.together) != (free.jobs, free.together) or fields == 1
    alone = resources(detector, 20, fields, fields, 4, 0.0)
    assert alone.jobs == 1
    assert alone.memory == resources(detector, 20, fields, fields, 1, float("inf")).memory


def test_few_images_take_one_process_and_no_more_jobs_than_there_are_images():
    assert resources(Detector(0.021, 64), 20, 10, 10, None, float("inf")).jobs == 1
    assert resources(Detector(0.021, 64), 20, 100, 3, 64, float("inf")).jobs == 3
    assert resources(None, 20, 100, 100, 2, float("inf")).output == 0.0


def test_a_thousand_fields_fit_into_300_MB():
    scene = recipe.plan(
        psfcli.load(PAPER, ["fields={start: 0 deg, stop: 0.5 deg, count: 1000}"]), jobs=2, max_memory=300e6
    )
    assert scene.resources.memory <= 300e6


@pytest.mark.parametrize("command", ["run", "plan"])
def test_memory_that_is_too_little_ends_with_3_and_says_what_would_do(tmp_path, command):
    done = psf(tmp_path, command, PAPER, "--max-memory", "1MB")
    assert (done.returncode, done.stdout) == (3, "")
    assert re.fullmatch(
        r"the accuracy asked for cannot be met: a field at a time in one process takes \d+ MB of memory, 1 MB are "
        r"allowed; reached is nothing, no product is written; .*--max-memory would do\n",
        done.stderr,
    )
    assert list(tmp_path.iterdir()) == []


def test_in_python_it_is_a_scene_error(tmp_path):
    with pytest.raises(psfcli.SceneError, match="cannot be met"):
        psfcli.write(paper(), tmp_path / "out", max_memory=1e6)
    assert list(tmp_path.iterdir()) == []


def without_figures(text):
    """A plan less what differs from run to run: its times."""
    return re.sub(r"about \S+ s", "", text)


def test_a_dry_run_says_what_plan_says_and_writes_nothing(tmp_path):
    options = (PAPER, *QUICK, "--field", "0.3 deg", "--field", "-0.3 deg", "--format", "fits", "--jobs", "2")
    plan, dry = psf(tmp_path, "plan", *options), psf(tmp_path, "run", *options, "--dry-run")
    assert plan.returncode == dry.returncode == 0
    assert without_figures(plan.stdout) == without_figures(dry.stdout)
    assert re.search(r"^field -0.3 deg +skipped", plan.stdout, re.MULTILINE)
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_looks_at_the_output_place(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for place, told in (("full", "is not empty"), ("file", "is a file"), ("file/below", "is a file")):
        done = psf(tmp_path, "run", PAPER, *QUICK, "-o", place, "--dry-run")
        assert (done.returncode, done.stdout) == (4, "")
        assert told in done.stderr
    huge = ("--set", "detector.pixels=16384", "--set", "fields={start: 0 deg, stop: 0.5 deg, count: 10000}")
    done = psf(tmp_path, "run", PAPER, *QUICK, *huge, "--dry-run")
    assert done.returncode == 4
    assert "bytes, the disk has" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "full"]


@pytest.mark.parametrize("formats", ["csv", ("fits", "png")])
def test_formats_that_are_none_are_told_before_anything_is_computed(tmp_path, formats):
    with pytest.raises(ValueError, match="is no list of some of fits, exr, csv"):
        psfcli.write(paper(), tmp_path / "out", formats=formats)


@pytest.mark.parametrize("format_", ["fits", "exr", "csv"])
def test_every_format_alone_can_be_written(tmp_path, format_):
    outcome = psfcli.write(paper(accuracy="draft", fields=["0.3 deg", "-0.3 deg"]), tmp_path, formats=[format_])
    names = {"fits": "psf.fits", "exr": "psf.exr", "csv": "ee.csv"}
    assert [path.name for path in outcome.paths] == [names[format_], "manifest.json"]


def test_the_manifest_keeps_the_whole_plan(tmp_path):
    psfcli.write(paper(accuracy="draft", fields=["0.3 deg", "-0.3 deg"]), tmp_path, formats=["csv"])
    plan = json.loads(Path(tmp_path, "manifest.json").read_text())["plan"]
    assert (plan["images"], plan["computed"]) == (2, 1)
    states = {each["effect"]: each["state"] for each in plan["effects"]}
    assert states["field 0.3 deg"] == "modelled"
    assert states["field -0.3 deg"] == states["cube"] == "skipped"
    for each in plan["effects"]:
        assert each["because"]
        assert each["state"] == "modelled" or {"ee", "pixel"} <= each.keys()


def test_the_time_predicted_has_the_writing_in_it_and_leaves_nothing(tmp_path, monkeypatch):
    system = paper(accuracy="draft")
    scene, images = planned(system)
    header = recipe.header(system, scene)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert writing_seconds(header, ("fits", "csv"), images[0, 0]) > 0.0
    # by a clock that ticks once per image of as many pixels as are tried
    clock, add = count(), rehearsal.ProductWriter.add
    now = [0]

    def ticking(*arguments):
        now[0] = next(clock)
        add(*arguments)

    monkeypatch.setattr(rehearsal.ProductWriter, "add", ticking)
    monkeypatch.setattr(rehearsal, "time", SimpleNamespace(perf_counter=lambda: float(now[0])))
    tried = min(header.detector.pixels, rehearsal._PIXELS)
    larger = (header.detector.pixels / tried) ** 2
    for times in (1, 2000):
        many = replace(header, fields=header.fields * times)
        first = writing_seconds(many, ("fits", "csv"), images[0, 0])
        assert first == pytest.approx(larger * len(many.fields), abs=1.0)
    assert list(tmp_path.iterdir()) == []


def test_without_room_to_try_the_time_predicted_says_that_writing_is_left_out(monkeypatch):
    assert " s beyond start-up, by 1 job" in describe(paper(accuracy="draft"), ("fits",), 1, None)
    monkeypatch.setattr(tempfile, "tempdir", str(Path(__file__) / "nowhere"))
    assert " s beyond start-up and writing, by 1 job" in describe(paper(accuracy="draft"), ("fits",), 1, None)
