"""Every measured figure and table of the documentation. ``make figures`` does all of it.

Usage: python scripts/figures.py            (needs matplotlib; takes several minutes)
       python scripts/figures.py pages      writes the tables anew from the measurements in docs/tradeoff/

Draws the picture of README.md, runs ``psfcli tradeoff`` on every configuration into docs/tradeoff/, and from these
tables writes docs/tradeoff.md, the table of README.md, and the price tags of the presets that ``psfcli run --help``
tells. From run to run only timings differ.
"""

from __future__ import annotations

import json
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import psfcli
from psfcli.tolerance import PRESETS
from psfcli.tradeoff.ladder import OURS
from psfcli.tradeoff.measurement import Measurement
from psfcli.tradeoff.table import HEADINGS, cells, read_csv

ROOT = Path(__file__).resolve().parent.parent
MEASURED = ROOT / "docs" / "tradeoff"
PRICES = ROOT / "psfcli" / "cli" / "prices.json"
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
PAPER = "euv_two_mirror"

BEGIN, END = "<!-- Measured: make figures -->", "<!-- End of what is measured -->"
COLUMNS = 0, 1, 4, 7, 9, 10  # of the table of psfcli tradeoff: the true errors, time as a ratio, memory
SHOWN = ("method", "setting", "largest error of a pixel", "of an ensquared energy", "time / `standard`", "memory [MB]")
MARGIN = 600.0  # seconds a rival may take: more than any does, so that a slow machine leaves none out


def measure() -> None:
    """Run ``psfcli tradeoff`` on every configuration."""
    MEASURED.mkdir(exist_ok=True)
    for config in CONFIGS:
        with tempfile.TemporaryDirectory() as directory:
            command = [sys.executable, "-m", "psfcli", "tradeoff", str(config), "--max-seconds", str(MARGIN)]
            finished = subprocess.run([*command, "-o", directory, "--overwrite"], cwd=ROOT, stdout=subprocess.DEVNULL)
            if finished.returncode not in {0, 3}:  # 3: an accuracy was missed, which the table shows
                sys.exit(finished.returncode)
            for suffix in (".csv", ".png"):
                content = Path(directory, f"tradeoff{suffix}").read_bytes()
                (MEASURED / config.with_suffix(suffix).name).write_bytes(content)


def measurements() -> dict[str, list[Measurement]]:
    """What was measured, by the stem of the configuration."""
    found = {}
    for config in CONFIGS:
        with (MEASURED / f"{config.stem}.csv").open(newline="", encoding="utf-8") as stream:
            found[config.stem] = read_csv(stream)
    return found


def prices(found: dict[str, list[Measurement]]) -> dict[str, dict[str, float]]:
    """Each preset's largest errors over the configurations, and the median of its time as a ratio to ``standard``."""
    ours = [{m.setting: m for m in each if m.method == OURS} for each in found.values()]
    return {
        name: {
            "pixel_error": _two_digits(max(steps[name].true.pixel for steps in ours)),
            "ee_error": _two_digits(max(steps[name].true.ee for steps in ours)),
            "time": _two_digits(statistics.median(steps[name].seconds / steps["standard"].seconds for steps in ours)),
        }
        for name in PRESETS
    }


def pages() -> dict[Path, str]:
    """The documentation and the price tags, as the measurements in docs/tradeoff/ make them."""
    found = measurements()
    tags = prices(found)
    paper = [m for m in found[PAPER] if m.method != OURS or m.setting in PRESETS]
    readme, tradeoff = ROOT / "README.md", ROOT / "docs" / "tradeoff.md"
    parts = [_price_table(tags)]
    for config in CONFIGS:
        picture = f"![Error against time: {config.stem}](tradeoff/{config.stem}.png)"
        parts.append(f"## {psfcli.load(config).title}\n\n{picture}\n\n{_table(found[config.stem])}")
    return {
        readme: _filled(readme, _table(paper)),
        tradeoff: _filled(tradeoff, "\n\n".join(parts)),
        PRICES: json.dumps(tags, indent=2) + "\n",
    }


def _table(found: list[Measurement]) -> str:
    assert [HEADINGS[i] for i in COLUMNS] == ["method", "setting", "true", "true", "/ standard", "memory [MB]"]
    return _markdown([list(SHOWN), *([row[i] for i in COLUMNS] for row in cells(found))])


def _price_table(tags: dict[str, dict[str, float]]) -> str:
    head = ["preset", "asked: pixel", "ee", "largest error of a pixel", "of an ensquared energy", "time / `standard`"]
    rows = [head]
    for name, tag in tags.items():
        asked = [f"`{name}`", f"{PRESETS[name].pixel:.0e}", f"{PRESETS[name].ee:.0e}"]
        rows.append([*asked, f"{tag['pixel_error']:.1e}", f"{tag['ee_error']:.1e}", f"{tag['time']:g}"])
    return _markdown(rows)


def _markdown(rows: list[list[str]]) -> str:
    head, *body = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, "|---" * 2 + "|---:" * (len(rows[0]) - 2) + "|", *body])


def _filled(page: Path, content: str) -> str:
    """The page with ``content`` between its marks."""
    text, count = re.subn(
        f"{BEGIN}\n.*?{END}",
        lambda _: f"{BEGIN}\n\n{content}\n\n{END}",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    assert count == 1, f"{page} needs its marks once"
    return text


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


if __name__ == "__main__":
    if sys.argv[1:] != ["pages"]:
        import picture

        picture.draw(picture.PICTURE)
        measure()
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
