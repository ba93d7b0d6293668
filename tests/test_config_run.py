"""A run of a bad system file ends with one line before anything is made."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BAD = Path(__file__).parent / "bad_configs"


@pytest.mark.parametrize(
    "name", ["unknown_key", "missing_pixel", "bare_pixel", "too_many_pixels", "both_conjugates", "tab_indent"]
)
def test_a_run_of_a_bad_file_is_one_line_and_writes_nothing(name: str, tmp_path: Path) -> None:
    path = BAD / f"{name}.yaml"
    command = [sys.executable, "-m", "psfcli", "run", str(path), "-o", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    expected = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"{path}:{expected}\n")
    assert list(tmp_path.iterdir()) == []
