"""make sweep: restarts where it stopped, in parallel or not, and gives the table of one run over all fields."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PSFCLI = f"{sys.executable} -m psfcli"
ARGS = "--format csv --accuracy draft"
CONFIG = """schema: 1
title: A small telescope
wavelengths: [9.4 nm, 19.5 nm]
telescope: {focal_length: 1750 mm, aperture_diameter: 190 mm, obscuration: 0.48, max_field: 0.5 deg,
  seidel: {reference_wavelength: 9.4 nm, W020: -30.35, W131: -7.6, W222: 48.34}}
surfaces:
  - {marginal_height: 95 mm, psd: {sigma: 0.682 nm, B: 1 mm, C: 1.8}}
fields: [0 deg]
detector: {pixel: 21 um, pixels: 4}
ensquared_energy: {half_widths: [10.5 um, 105 um, 1.05 mm, 21 mm]}
"""

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")


class Place:
    """A directory with the Makefile, and the sweeps in it."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        shutil.copy(ROOT / "Makefile", directory)
        (directory / "scripts").mkdir()
        shutil.copy(ROOT / "scripts" / "sweep_merge.py", directory / "scripts")
        self.config = directory / "small.yaml"
        self.config.write_text(CONFIG)
        self.products = directory / "sweep" / "small"

    def sweep(self, fields: str = "0 0.1 0.2", *options: str, args: str = ARGS, psfcli: str = PSFCLI) -> list[str]:
        """The angles that ``make sweep`` computed."""
        settings = [f"PSFCLI={psfcli}", f"PYTHON={sys.executable}", f"FIELDS={fields}", f"SWEEP_ARGS={args}"]
        command = ["make", "sweep", "CONFIG=small.yaml", *settings, *options]
        done = subprocess.run(command, cwd=self.directory, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return sorted(line.split()[2] for line in done.stdout.splitlines() if line.startswith("small: field"))

    def table(self) -> bytes:
        return (self.products / "ee.csv").read_bytes()


@pytest.fixture
def place(tmp_path):
    return Place(tmp_path)


def one_run(place: Place, *fields: str, args: str = ARGS) -> bytes:
    """The table of one process over all fields."""
    asked = [option for field in fields for option in ("--field", f"{field} deg")]
    command = [*PSFCLI.split(), "run", str(place.config), "-o", str(place.directory / "one"), *args.split(), *asked]
    subprocess.run(command, check=True, capture_output=True)
    return (place.directory / "one" / "ee.csv").read_bytes()


def test_the_merged_table_is_that_of_one_run_over_all_fields(place):
    assert place.sweep("0.2 0 0.1 0.2") == ["0", "0.1", "0.2"]
    assert place.table() == one_run(place, "0", "0.1", "0.2")


def test_the_merged_table_of_the_default_boxes_is_that_of_one_run_too(place):
    place.config.write_text("".join(line for line in CONFIG.splitlines(True) if "half_widths" not in line))
    place.sweep("0 0.25 0.5", args="--format csv")
    assert place.table() == one_run(place, "0", "0.25", "0.5", args="--format csv")


def test_finished_angles_are_not_done_again_and_new_ones_are(place):
    place.sweep()
    before = place.table()
    assert place.sweep() == []
    assert place.table() == before
    place.config.touch()  # as a fresh checkout does; the content is what counts
    assert place.sweep() == []
    assert place.sweep("0 0.1 0.2 -0.1") == ["-0.1"]


def test_an_angle_without_a_manifest_is_completed(place):
    place.sweep()
    before = place.table()
    (place.products / "field_0.1" / "manifest.json").unlink()
    (place.products / "field_0.1" / "ee.csv").write_text("half")
    (place.products / "ee.csv").unlink()
    assert place.sweep() == ["0.1"]
    assert place.table() == before


def test_a_changed_system_file_or_changed_options_redo_every_angle(place):
    place.sweep("0 0.1")
    place.config.write_text(CONFIG.replace("C: 1.8", "C: 1.9"))
    assert place.sweep("0 0.1") == ["0", "0.1"]
    assert place.sweep("0 0.1", args=ARGS + " --set surfaces.0.psd.C=2") == ["0", "0.1"]


def test_two_at_a_time_give_the_same_table(place):
    place.sweep()
    before = place.table()
    shutil.rmtree(place.products)
    assert place.sweep("0 0.1 0.2", "-j2") == ["0", "0.1", "0.2"]
    assert place.table() == before


def test_an_angle_that_fails_is_told_and_its_sweep_is_no_success(place):
    place.config.write_text(CONFIG.replace("C: 1.8", "C: 0.8"))
    with pytest.raises(AssertionError, match="surfaces"):
        place.sweep("0")
    assert not (place.products / "ee.csv").exists()


def test_a_merge_of_tables_that_disagree_names_the_row(tmp_path):
    header = "wavelength_nm,field,azimuth_deg,half_width_um,ee\n"
    for name, energy in (("a", "0.5"), ("b", "0.6")):
        (tmp_path / name).write_text(f"{header}9.4,0.0,90.0,10.5,{energy}\n")
    command = [sys.executable, ROOT / "scripts" / "sweep_merge.py", "all", "a", "b"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "b: line 2 differs from the same box of another table\n"
    assert not (tmp_path / "all").exists()
