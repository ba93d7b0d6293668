from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from product_scenes import random_image, run_header, write_run

from psfcli.image.grid import Detector
from psfcli.products import OutputError
from psfcli.products.atomic import TEMPORARY
from psfcli.products.writer import ProductWriter

PRODUCTS = ["ee.csv", "manifest.json", "psf.exr", "psf.fits"]


def contents(directory):
    return {p.name: p.read_bytes() for p in directory.iterdir()}


def run_script(script, directory, **options):
    """Start a Python program that has the scenes at hand and the directory as ``out``."""
    start = (
        "import sys, os, signal, time; from pathlib import Path; from product_scenes import *; out = Path(sys.argv[1])"
    )
    return subprocess.Popen(
        [sys.executable, "-c", start + script, str(directory)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def test_two_runs_write_the_same_bytes_but_the_manifest(tmp_path):
    for name in ("a", "b"):
        write_run(tmp_path / name, run_header(waves=(9.4e-6, 17.1e-6)))
    a, b = contents(tmp_path / "a"), contents(tmp_path / "b")
    assert sorted(a) == PRODUCTS
    assert all(a[name] == b[name] for name in a if name != "manifest.json")


def test_the_manifest_knows_every_product(tmp_path):
    products = write_run(tmp_path / "new" / "place", run_header())
    manifest = json.loads((tmp_path / "new" / "place" / "manifest.json").read_text())
    assert [p.name for p in products.paths] == [*manifest["products"], "manifest.json"]
    for path in products.paths[:-1]:
        assert manifest["products"][path.name]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert manifest["input"] == {"file": "two.yaml", "sha256": "ab" * 32}
    assert (manifest["command"], manifest["timings"]) == ("psfcli run two.yaml", {"images": 0.1})
    assert manifest["accuracy"] == {"pixel": 1e-3, "ee": 1e-5}


def test_memory_does_not_grow_with_the_fields(tmp_path):
    header = run_header(fields=80, detector=Detector(0.021, 32, 5))
    image = random_image(header)
    plane = image.psf_over.nbytes
    write_run(tmp_path / "warm", run_header(fields=1))
    peaks = []
    for number in range(3):  # what other threads of the tests allocate meanwhile is traced, too: the least counts
        tracemalloc.start()
        try:
            with ProductWriter(tmp_path / f"out{number}", header) as products:
                for field in range(80):
                    products.add(0, field, image)
                peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    # the plane turned to big-endian and to float32, its sums, and the header of 160 parts; 80 planes would be 16 MB
    assert min(peaks) < 6 * plane


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt])
def test_a_run_that_fails_leaves_the_old_products_whole(tmp_path, kind):
    write_run(tmp_path, run_header(title="old"))
    old = contents(tmp_path)
    with pytest.raises(kind):
        write_one_of_three(tmp_path, kind)
    assert contents(tmp_path) == old


def write_one_of_three(directory, fault):
    with ProductWriter(directory, run_header(), overwrite=True) as products:
        products.add(0, 0, random_image(run_header()))
        raise fault


def test_a_run_that_fails_leaves_no_new_directory(tmp_path):
    with pytest.raises(RuntimeError), ProductWriter(tmp_path / "a" / "b", run_header()):
        raise RuntimeError
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("moment", ["start", "half", "commit"])
def test_a_killed_run_leaves_every_file_old_or_new_and_the_next_cleans_up(tmp_path, moment):
    write_run(tmp_path, run_header(title="old"))
    old = contents(tmp_path)
    script = f"""
from psfcli.products import atomic
def kill(*_):
    os.kill(os.getpid(), signal.SIGKILL)
if {moment!r} == "commit":
    replace, seen = Path.replace, []
    def counted(self, target):
        if seen:
            kill()
        seen.append(target)
        return replace(self, target)
    Path.replace = counted
header = run_header()
with ProductWriter(out, header, overwrite=True) as products:
    for field in range(3):
        if {moment!r} == "start" or ({moment!r} == "half" and field == 2):
            kill()
        products.add(0, field, random_image(header, field))
"""
    killed = run_script(script, tmp_path)
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    write_run(tmp_path.parent / f"{tmp_path.name}-new", run_header())
    new = contents(tmp_path.parent / f"{tmp_path.name}-new")
    left = contents(tmp_path)
    assert any(name.startswith(TEMPORARY) for name in left)
    if moment == "commit":
        assert "manifest.json" not in left
        with pytest.raises(OutputError, match="incomplete run"):
            ProductWriter(tmp_path, run_header())
    else:
        assert left["manifest.json"] == old["manifest.json"]
    for name in ("psf.fits", "psf.exr", "ee.csv"):
        assert left[name] in ((old[name], new[name]) if moment == "commit" else (old[name],))
    write_run(tmp_path, run_header(), overwrite=True)
    assert contents(tmp_path) == new


def test_a_worker_that_outlives_a_killed_run_does_not_keep_the_directory(tmp_path):
    script = """
with ProductWriter(out, run_header()):
    if os.fork() == 0:
        print(os.getpid(), flush=True)
        time.sleep(60)
    time.sleep(0.2)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = run_script(script, tmp_path)
    worker = int(killed.stdout.readline())
    killed.wait()
    try:
        write_run(tmp_path, run_header())
    finally:
        os.kill(worker, signal.SIGKILL)
        killed.communicate()
    assert sorted(contents(tmp_path)) == PRODUCTS


def test_two_runs_cannot_write_to_one_directory(tmp_path):
    with (
        ProductWriter(tmp_path, run_header(fields=0), ("csv",)),
        pytest.raises(OutputError, match="another run"),
        ProductWriter(tmp_path, run_header()),
    ):
        pass


@pytest.mark.parametrize("format_", ["fits", "exr", "csv"])
def test_a_file_size_limit_is_one_line_and_leaves_the_old_products(tmp_path, format_):
    write_run(tmp_path, run_header(title="old"))
    old = contents(tmp_path)
    script = f"""
import resource
from psfcli.products import OutputError
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
try:
    write_run(out, run_header(), ({format_!r},), overwrite=True)
except OutputError as fault:
    print(fault)
"""
    told, trouble = run_script(script, tmp_path).communicate()
    assert "file-size limit" in told, trouble
    assert told.count("\n") == 1
    assert trouble == ""
    assert contents(tmp_path) == old


@pytest.mark.parametrize("lacking", [1, 100, 3000])
def test_an_exr_file_without_its_end_is_told(tmp_path, lacking):
    write_run(tmp_path / "whole", run_header(), ("exr",))
    limit = (tmp_path / "whole" / "psf.exr").stat().st_size - lacking
    write_run(tmp_path / "out", run_header(title="old"), ("exr",))
    old = contents(tmp_path / "out")
    script = f"""
import resource
from psfcli.products import OutputError
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
try:
    write_run(out, run_header(), ("exr",), overwrite=True)
except OutputError as fault:
    print(fault)
"""
    told, trouble = run_script(script, tmp_path / "out").communicate()
    assert "file-size limit" in told, trouble
    assert told.count("\n") == 1
    assert contents(tmp_path / "out") == old


@pytest.fixture
def small_disk(tmp_path):
    mounted = tmp_path / "disk"
    mounted.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(mounted)], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip("no file system can be mounted here")
    yield mounted
    subprocess.run(["umount", str(mounted)], check=True)


def test_a_disk_too_small_is_told_before_anything_is_computed(small_disk):
    with (
        pytest.raises(OutputError, match="bytes, the disk has"),
        ProductWriter(small_disk / "out", run_header(detector=Detector(0.021, 64, 5))),
    ):
        pytest.fail("the run began")
    assert contents(small_disk) == {}


def test_a_disk_that_fills_up_leaves_the_old_products(small_disk):
    write_run(small_disk / "out", run_header(title="old"))
    old = contents(small_disk / "out")
    with pytest.raises(OutputError, match="the disk is full"):
        write_while_the_disk_fills_up(small_disk)
    assert contents(small_disk / "out") == old


def write_while_the_disk_fills_up(disk):
    header = run_header()
    with ProductWriter(disk / "out", header, overwrite=True) as products:
        fill(disk / "other")
        for field in range(3):
            products.add(0, field, random_image(header, field))


def fill(path):
    with path.open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while stream.write(bytes(4096)):
            pass


def test_a_directory_with_anything_in_it_needs_overwrite(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty"):
        ProductWriter(tmp_path, run_header())
    write_run(tmp_path, run_header(), overwrite=True)
    with pytest.raises(OutputError, match="already holds products"):
        ProductWriter(tmp_path, run_header())
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_an_empty_directory_will_do(tmp_path):
    write_run(tmp_path, run_header())
    assert sorted(contents(tmp_path)) == PRODUCTS


def test_products_that_are_not_written_again_go(tmp_path):
    write_run(tmp_path, run_header(fields=65, detector=Detector(0.021, 2, 1)))
    (tmp_path / "psf_mine.exr").touch()
    write_run(tmp_path, run_header(), ("csv",), overwrite=True)
    assert sorted(contents(tmp_path)) == ["ee.csv", "manifest.json", "psf_mine.exr"]


@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_file_in_the_way_is_told(tmp_path, below):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file") as told, ProductWriter(tmp_path / "file" / below, run_header()):
        pass
    assert "\n" not in str(told.value)


def test_a_directory_in_the_way_of_a_product_is_told_before_anything_changes(tmp_path):
    (tmp_path / "psf.fits").mkdir()
    with pytest.raises(OutputError, match="is a directory"):
        ProductWriter(tmp_path, run_header(), overwrite=True)


def test_an_unwritable_place_is_told():
    with pytest.raises(OutputError, match="/proc/"), ProductWriter(Path("/proc/psf"), run_header()):
        pass


@pytest.mark.parametrize("added", [(), (0, 1), (0, 1, 1)])
def test_images_that_were_announced_must_come_once_each(tmp_path, added):
    with pytest.raises(ValueError, match="3 announced"):
        write_images(tmp_path, added)
    assert contents(tmp_path) == {}


def write_images(directory, indices):
    header = run_header()
    with ProductWriter(directory, header) as products:
        for index in indices:
            products.add(0, index, random_image(header))
