"""What a command loads: libraries that take longer to import than the work takes come only where they are needed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

CONFIG = Path(__file__).resolve().parent.parent / "configs" / "euv_two_mirror.yaml"

WATCH = """
import json, sys
from psfcli.cli import main
try:
    main(json.loads(sys.argv[1]))
except SystemExit as end:
    code = end.code
json.dump({"code": code, "modules": list(sys.modules)}, open(sys.argv[2], "w"))
"""


def loaded(tmp_path: Path, *arguments: str) -> set[str]:
    """The modules loaded once ``psfcli`` has done what the arguments ask."""
    note = tmp_path / "modules.json"
    # -P: nothing is imported from the current directory
    command = [sys.executable, "-P", "-c", WATCH, json.dumps(arguments), str(note)]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    found = json.loads(note.read_text())
    assert not found["code"]
    return set(found["modules"])


@pytest.mark.parametrize("command", [["--help"], ["--version"]], ids="".join)
def test_help_loads_nothing_but_the_command_line(tmp_path, command):
    assert not loaded(tmp_path, *command) & {"numpy", "yaml", "scipy", "astropy", "OpenEXR", "matplotlib"}


def test_check_loads_neither_the_physics_nor_the_products(tmp_path):
    modules = loaded(tmp_path, "check", str(CONFIG))
    assert not modules & {"scipy", "astropy.io", "astropy.io.fits", "astropy.table", "OpenEXR", "matplotlib"}


def test_a_table_of_energies_needs_no_image_format(tmp_path):
    options = ("--format", "csv", "--accuracy", "draft", "--field", "0 deg", "-o", str(tmp_path / "out"), "-q")
    modules = loaded(tmp_path, "run", str(CONFIG), *options)
    assert not modules & {"astropy.io", "astropy.io.fits", "astropy.table", "astropy.wcs", "OpenEXR", "matplotlib"}


def test_the_errors_users_catch_are_names_of_the_package():
    import psfcli

    assert set(psfcli.__all__) == set(dir(psfcli))
    for name in ("ConfigError", "OutputError", "SceneError"):
        assert issubclass(getattr(psfcli, name), Exception)
