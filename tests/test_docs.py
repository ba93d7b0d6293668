"""Documentation that cannot drift: what README, CONTRIBUTING and docs/ say is what the program does.

``python tests/test_docs.py`` writes the reference in docs/system_file.md anew.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest

import psfcli
from psfcli.cli import main
from psfcli.config import reference
from psfcli.tolerance import PRESETS

ROOT = Path(__file__).resolve().parent.parent
PAGES = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")}
README = PAGES["README.md"]
SYSTEM_FILE = ROOT / "docs" / "system_file.md"
MARK = '<!-- What follows is psfcli.config.reference(); "python tests/test_docs.py" writes it anew. -->\n\n'
PAPER = ROOT / "configs" / "euv_two_mirror.yaml"


def snippets(page: str, language: str) -> list[str]:
    """The fenced blocks of a language on a page, at least one."""
    found = re.findall(rf"^```{language}\n(.*?)^```$", PAGES[page], re.MULTILINE | re.DOTALL)
    assert found, f"{page} has no {language} snippet"
    return found


def table(heading: str) -> list[list[str]]:
    """The rows of the README's table whose first column is headed so, as cells."""
    head = README.index(f"\n| {heading} |")
    rows = README[head + 1 :].split("\n\n")[0].splitlines()
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for row in rows[2:]]


def commands() -> dict[str, click.Command]:
    context = click.Context(main)
    found = {name: main.get_command(context, name) for name in main.list_commands(context)}
    return {name: command for name, command in found.items() if command}


def options(command: click.Command) -> set[str]:
    """Every spelling of every option, help apart."""
    return {spelling for p in command.params if isinstance(p, click.Option) for spelling in p.opts} - {"--help", "-h"}


def psf(directory: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "psfcli", *map(str, arguments)]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False)


def test_every_command_is_in_the_table_of_commands():
    listed = [re.match(r"`psfcli ([\w-]+)", row[0])[1] for row in table("command")]
    assert listed == list(commands())


def test_every_option_is_in_the_table_with_the_commands_that_have_it():
    listed: dict[str, set[str]] = {name: set() for name in commands()}
    for cell, names, _ in table("option"):
        for name in re.findall(r"`([\w-]+)`", names):
            listed[name] |= set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", cell))
    assert listed == {name: options(command) for name, command in commands().items()}


def test_the_options_of_the_program_itself_are_mentioned():
    for spelling in options(main) | {"-h", "--help"}:
        assert re.search(rf"`(psfcli )?{spelling}`", README), spelling


def test_values_an_option_may_take_are_mentioned():
    for command in commands().values():
        for parameter in command.params:
            if isinstance(parameter.type, click.Choice):
                assert all(f"`{choice}`" in README for choice in parameter.type.choices)


def test_the_accuracies_are_those_of_the_program():
    listed = {name.strip("`"): (float(pixel), float(ee)) for name, pixel, ee in table("name")}
    assert listed == {name: (asked.pixel, asked.ee) for name, asked in PRESETS.items()}


def test_the_exit_codes_are_those_of_the_table(tmp_path):
    run = ("run", PAPER, "--format", "csv", "--accuracy", "draft", "--field", "0 deg", "-q")
    met = {
        psf(tmp_path, *run, "-o", "done").returncode: 0,
        psf(tmp_path, *run, "-o", "steep", "--set", "surfaces.0.psd.C=300").returncode: 1,
        psf(tmp_path, *run, "-o", "fault", "--set", "telescope.obscuration=2").returncode: 2,
        psf(
            tmp_path, "run", PAPER, "--format", "csv", "-o", "hard", "--pixel-error", "1", "--ee-error", "1e-12"
        ).returncode: 3,
        psf(tmp_path, *run, "-o", "done").returncode: 4,
        interrupted(tmp_path / "long"): 130,
    }
    assert {code: code for code in met} == met
    assert psf(tmp_path, *run, "-o", "small", "--max-memory", "1MB").returncode == 3
    assert [int(row[0]) for row in table("exit code")] == sorted(met)
    assert psf(tmp_path, "compare", "done", "done").returncode == 0
    assert psf(tmp_path, "compare", "done", "hard", "--pixel-error", "0", "--ee-error", "0").returncode in {1, 2}
    assert psf(tmp_path, "compare", "done", "nowhere").returncode == 2


def interrupted(directory: Path) -> int:
    """The exit code of a run that is interrupted once it has begun to write into ``directory``."""
    many = ["--set", "fields={start: 0 deg, stop: 0.5 deg, count: 2000}", "--jobs", "1"]
    command = [sys.executable, "-m", "psfcli", "run", str(PAPER), "-o", str(directory), *many, "--format", "csv"]
    # in the background of a shell SIGINT would be ignored, and by all that is started there
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 60.0
    while not directory.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    return process.wait(timeout=60.0)


def test_system_files_in_the_readme_are_faultless(tmp_path):
    for number, text in enumerate(snippets("README.md", "yaml")):
        file = tmp_path / f"{number}.yaml"
        file.write_text(text, encoding="utf-8")
        assert not psfcli.load(file).warnings


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A directory as the snippets expect it: the configurations and, at draft accuracy, what ``make run`` leaves."""
    directory = tmp_path_factory.mktemp("place")
    shutil.copytree(ROOT / "configs", directory / "configs")
    finished = psf(directory, "run", "configs/euv_two_mirror.yaml", "--accuracy", "draft", "--format", "fits")
    assert finished.returncode == 0, finished.stderr
    return directory


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_python_snippets_run(page, place):
    for snippet in snippets(page, "python"):
        command = [sys.executable, "-W", "error", "-c", snippet]
        finished = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        assert finished.returncode == 0, finished.stderr
        assert finished.stdout


def test_the_two_rays_agree_as_contributing_says():
    printed = subprocess.run(
        [sys.executable, "-c", snippets("CONTRIBUTING.md", "python")[0]], capture_output=True, text=True, check=True
    ).stdout
    agreement = {float(C): float(apart) for C, apart in (line.split() for line in printed.splitlines())}
    # the figures of the text, doubled where they are measured ones: libraries differ in the last bits of kv, jv, yv
    assert all(apart <= 1e-15 for C, apart in agreement.items() if C <= 4.0)
    assert agreement[8.0] <= 1e-12
    assert agreement[12.0] <= 2e-7


def test_the_reference_is_made_from_the_table_of_keys():
    text = SYSTEM_FILE.read_text(encoding="utf-8")
    assert MARK in text
    assert text.split(MARK)[1] == reference(), '"python tests/test_docs.py" writes it anew'


def code(text: str) -> str:
    """The shell blocks and what stands in backticks, one piece per line."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return "\n".join([*blocks, *re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text)])


def test_every_make_target_mentioned_exists():
    targets = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)[1].split()
    for name, text in PAGES.items():
        for words in re.findall(r"^make ([^#\n]+)", code(text), re.MULTILINE):
            asked = [word for word in re.sub(r'\w+=("[^"]*"|\S*)', "", words).split() if not word.startswith("-")]
            assert asked, f"{name}: make {words}"
            assert set(asked) <= set(targets), f"{name}: make {words}"


def test_every_make_variable_mentioned_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for name, text in PAGES.items():
        for words in re.findall(r"\bmake ([^#\n`]+)", text):
            for variable in re.findall(r"\b([A-Z_]+)=", words):
                assert re.search(rf"^{variable} \?=", makefile, re.MULTILINE), f"{name}: {variable}"


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", PAGES[page]):
        assert "://" in target or (ROOT / target).exists(), target


@pytest.mark.parametrize("page", PAGES)
def test_every_file_named_exists(page):
    named = re.findall(
        r"`((?:configs|docs|scripts|tests|psfcli|config|surface|image|products|cli|\.ci)/[\w./]*)`", PAGES[page]
    )
    for name in named:
        assert (ROOT / name).exists() or (ROOT / "psfcli" / name).exists(), name


def test_contributing_names_every_part_of_the_house_and_what_it_explains():
    inside = ROOT / "psfcli"
    parts = {f"psfcli/{p.name}{'/' if p.is_dir() else ''}" for p in inside.iterdir() if p.suffix in {"", ".py"}}
    parts -= {"psfcli/__init__.py", "psfcli/__main__.py", "psfcli/__pycache__/"}
    named = re.findall(r"^\| `(psfcli/[\w./]+)` \|", PAGES["CONTRIBUTING.md"], re.MULTILINE)
    assert sorted(named) == sorted(parts)
    for module in re.findall(r"`(\w+\.py)`", PAGES["CONTRIBUTING.md"]):
        assert list(inside.rglob(module)) or module == "run.py", module


def test_the_picture_is_there_and_small():
    picture = (ROOT / "docs" / "euv_two_mirror.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n")
    assert len(picture) < 200_000


def test_the_changelog_knows_the_version():
    from importlib.metadata import version

    assert f"## {version('psfcli')}" in PAGES["CHANGELOG.md"]


if __name__ == "__main__":
    before = SYSTEM_FILE.read_text(encoding="utf-8").split(MARK)[0]
    SYSTEM_FILE.write_text(before + MARK + reference(), encoding="utf-8")
