"""Each bad system file gets exactly one line, which says where and what, and leaves nothing behind."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from psfcli.cli import main

BAD = sorted((Path(__file__).parent / "bad_configs").glob("*.yaml"))

BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
BYTES = {
    "empty": (b"", ":1:1: empty; a system file begins with schema: 1"),
    "only_comments": (b"# nothing\n", ":1:1: empty; a system file begins with schema: 1"),
    "a_list": (b"- schema: 1\n", ":1:1: a list where a mapping of keys is wanted"),
    "a_word": (b"hello\n", ":1:1: 'hello' where a mapping of keys is wanted"),
    "latin_1": (b"schema: 1\ntitle: \xe9toile\n", ":2:8: byte 0xe9 is not UTF-8; save the file as UTF-8 text"),
    "utf_16": ("schema: 1\n".encode("utf-16"), ":1:1: byte 0xff is not UTF-8; save the file as UTF-8 text"),
    "null_character": (b"schema: 1\ntitle: a\0b\n", ":2:9: character U+0000 is not allowed in YAML"),
    "deep_lists": (b"[" * 30_000, ":1:22: nested deeper than 20 levels"),
    "deep_mappings": (b"{a: " * 30_000, ":1:85: nested deeper than 20 levels"),
    "deep_dashes": (b"- " * 30_000, ":1:43: nested deeper than 20 levels"),
    "exploding_aliases": (BOMB.encode(), ":6:8: more than 200000 values once aliases are expanded"),
    "too_large": (b"#" * (2**21 + 1), ": larger than 2 MiB; a system file is wanted"),
}


def answer(path: str) -> tuple[int, list[str], str]:
    """Exit code, lines on stderr, and stdout of ``psfcli check``."""
    result = CliRunner().invoke(main, ["check", path])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stderr.splitlines(), result.stdout


def test_there_are_at_least_sixty_bad_files() -> None:
    assert len(BAD) >= 60


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_a_bad_file_gets_the_one_line_it_promises(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
    monkeypatch.chdir(tmp_path)
    assert answer(str(path)) == (2, [f"{path}:{expected}"], "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_a_promised_line_has_a_position(path: Path) -> None:
    assert re.match(r"# \d+:\d+: \S", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", BYTES)
def test_bytes_that_are_no_system_file_get_one_line(name: str, tmp_path: Path) -> None:
    data, expected = BYTES[name]
    path = tmp_path / "x.yaml"
    path.write_bytes(data)
    assert answer(str(path)) == (2, [f"{path}{expected}"], "")


def test_a_missing_file_gets_one_line(tmp_path: Path) -> None:
    path = str(tmp_path / "none.yaml")
    assert answer(path) == (2, [f"{path}: no such file"], "")


def test_no_name_gets_one_line() -> None:
    assert answer("") == (2, ["'': no such file; a system file is wanted"], "")


def test_a_directory_gets_one_line(tmp_path: Path) -> None:
    assert answer(str(tmp_path)) == (2, [f"{tmp_path}: is a directory; a system file is wanted"], "")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_gets_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.touch(mode=0)
    assert answer(str(path)) == (2, [f"{path}: cannot be read: Permission denied"], "")


def test_many_faults_are_answered_in_nine_lines(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("".join(f"key_{i}: 1\n" for i in range(30)))
    code, lines, _ = answer(str(path))
    assert code == 2
    assert len(lines) == 9
    assert lines[-1] == "... and 28 more faults"


@pytest.mark.parametrize("name", ["unknown_key", "tab_indent", "custom_tag"])
def test_the_installed_command_answers_the_same_without_a_traceback(name: str, tmp_path: Path) -> None:
    path = next(path for path in BAD if path.stem == name)
    command = [sys.executable, "-m", "psfcli", "check", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    expected = path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"{path}:{expected}\n")


def test_standard_input_is_named_so() -> None:
    result = CliRunner().invoke(main, ["check", "-"], input="schema: 2\n")
    assert result.stderr.startswith("<stdin>:1:1: wavelengths: missing key")
    assert result.exit_code == 2


def test_checking_loads_neither_numpy_nor_astropy() -> None:
    good = "import sys; from psfcli.config import load; load('-'); print([m for m in sys.modules if m in HEAVY])"
    program = f"HEAVY = {{'numpy', 'scipy', 'astropy', 'OpenEXR'}}; {good}"
    text = re.sub(r"^# .*\n", "", next(p for p in BAD if p.stem == "schema_2").read_text()).replace(
        "schema: 2", "schema: 1"
    )
    done = subprocess.run([sys.executable, "-c", program], input=text, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_help_loads_no_command() -> None:
    program = (
        "import sys; from psfcli.cli import main; main(['--help'], standalone_mode=False); print('yaml' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("False\n")
