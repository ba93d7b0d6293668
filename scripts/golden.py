"""Golden products: small runs of every configuration, kept in tests/golden/ and compared with what psfcli computes now.

``check`` runs each configuration at standard and at reference accuracy and compares it with its golden products, which
are of reference accuracy; allowed is the sum of the accuracies asked for. A configuration without golden products, or
golden products without their configuration, fail. ``update`` writes the golden products anew and prints what changed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PRODUCTS = ("psf.fits", "ee.csv")
# A small window: the sums over all light, which see a change anywhere, do not need a large one.
REDUCED = ("--set", "detector.pixels=12", "--set", "detector.oversample=2", "--format", "fits,csv")
KEPT = "reference"
CHECKED = ("standard", "reference")


def psfcli(*arguments: str | Path) -> tuple[int, str]:
    """The exit code of the command and all it printed."""
    command = [sys.executable, "-m", "psfcli", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.returncode, (done.stdout + done.stderr).strip()


def compute(config: Path, accuracy: str, directory: Path) -> str:
    """Run a configuration, reduced, into ``directory``; returns why it failed, or nothing."""
    code, printed = psfcli("run", config, "-o", directory, "--accuracy", accuracy, "--quiet", *REDUCED)
    return f"psfcli run ended with {code}: {printed}" if code else ""


def check(config: Path, golden: Path) -> tuple[bool, str]:
    """Whether a configuration still gives its golden products, and a report."""
    missing = [name for name in PRODUCTS if not (golden / name).is_file()]
    if missing:
        return False, f"no golden {' and '.join(missing)} in {golden}; make golden-update writes them"
    passed, lines = True, []
    with tempfile.TemporaryDirectory() as directory:
        for accuracy in CHECKED:
            fresh = Path(directory, accuracy)
            problem = compute(config, accuracy, fresh)
            code, report = (2, problem) if problem else psfcli("compare", golden, fresh)
            passed = passed and code == 0
            lines.append(f"{accuracy}: {report.splitlines()[-1]}" if code == 0 else f"{accuracy}:\n{report}")
    return passed, "\n".join(lines)


def update(config: Path, golden: Path) -> tuple[bool, str]:
    """Write the golden products of a configuration; whether that went well, and what changed."""
    with tempfile.TemporaryDirectory() as directory:
        fresh = Path(directory, KEPT)
        problem = compute(config, KEPT, fresh)
        if problem:
            return False, problem
        known = all((golden / name).is_file() for name in PRODUCTS)
        _, report = psfcli("compare", golden, fresh) if known else (0, "new")
        golden.mkdir(parents=True, exist_ok=True)
        for name in PRODUCTS:
            shutil.copyfile(fresh / name, golden / name)
    return True, report


def main() -> int:
    """Check or update; 0 when all is well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("check", "update"))
    parser.add_argument("--configs", type=Path, default=ROOT / "configs", help="directory of the configurations")
    parser.add_argument("--golden", type=Path, default=ROOT / "tests" / "golden", help="directory of the products")
    asked = parser.parse_args()
    configs = sorted(asked.configs.resolve().glob("*.yaml"))
    places = [asked.golden.resolve() / config.stem for config in configs]
    task = check if asked.action == "check" else update
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        outcomes = list(pool.map(task, configs, places))
    for config, (passed, report) in zip(configs, outcomes, strict=True):
        print(f"{config.stem}: {'ok' if passed else 'FAILED'}")
        print("".join(f"    {line}\n" for line in report.splitlines()), end="")
    stray = sorted(set(asked.golden.resolve().glob("*/")) - set(places))
    for directory in stray:
        print(f"{directory}: FAILED\n    no configuration of that name; remove the directory")
    return 0 if configs and not stray and all(passed for passed, _ in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
