"""Whether the accuracy asked for is the accuracy got, over random system files; ``make accuracy N=1000 SEED=1``.

Each draw is run at several accuracies and held against the judge of tests/truth, which shares no method with psfcli;
``tests/promise.py`` says what is compared. Violations, or exit code 3 in more than 2 % of the draws, fail.
"""

from __future__ import annotations

import argparse
import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import signal
import statistics
import sys
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import yaml
from promise import ASKED, NOTHING, Draw, Kept, examined
from truth.random_systems import drawn

MOST_SHORT = 0.02  # share of the draws that may end with exit code 3
SLOW = 5.0  # product seconds of a draw worth telling


@dataclass(frozen=True)
class Broken:
    """A draw that could not be examined, and why."""

    number: int
    why: str


def draw(seed: int, number: int, limit: float) -> Draw | Broken:
    """The draw examined; what raises, or takes more than ``limit`` processor seconds, is broken."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"more than {limit:g} s")

    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, limit)
    try:
        return examined(seed, number)
    except Exception as error:  # one broken draw must not hide the others
        trace, where = error.__traceback__, ""
        while trace is not None:
            where, trace = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}", trace.tb_next
        return Broken(number, f"{type(error).__name__}: {error} ({where})")
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


def lines(found: Draw | Broken) -> list[str]:
    """What is wrong with a draw, or slow."""
    if isinstance(found, Broken):
        return [f"draw {found.number}: not examined: {found.why}"]
    told = []
    for run in found.runs:
        head = f"draw {found.number} at {run.asked.pixel:.0e}: "
        told += [f"{head}VIOLATION {violation}" for violation in run.violations]
        if run.refused:
            told.append(f"{head}refused: {run.refused}")
        elif run.short:
            reached = ", ".join(f"{n} {getattr(run.told, n):.1e} of {getattr(run.asked, n):.0e}" for n in run.short)
            told.append(f"{head}exit 3: {reached}")
    if (total := sum(run.seconds for run in found.runs)) > SLOW:
        each = " + ".join(f"{run.seconds:.1f}" for run in found.runs)
        told.append(f"draw {found.number}: slow: {each} = {total:.1f} s")
    return told


def verbose(found: Draw | Broken) -> None:
    """Every run of a draw, kept promises too."""
    for line in lines(found):
        print(line)
    for run in found.runs if isinstance(found, Draw) else ():
        for name, place in zip(("pixel", "ee"), run.places, strict=True):
            asked, told, true = (getattr(part, name) for part in (run.asked, run.told, run))
            print(f"  asked {asked:.0e} {name:5} told {told:.2e} true {true:.2e} at {place} ({run.seconds:.2f} s)")


def summary(found: list[Draw | Broken]) -> bool:
    """Print the figures of all draws; whether the promise holds."""
    draws = [d for d in found if isinstance(d, Draw)]
    runs = [run for d in draws for run in d.runs]
    violations = sum(len(run.violations) for run in runs)
    short = sum(any(run.short for run in d.runs) for d in draws) / max(1, len(draws))
    limits = Counter(limit for run in runs for limit in ((f"refused: {run.refused}",) if run.refused else run.short))
    print(f"draws {len(draws)}, not examined {len(found) - len(draws)}, runs {len(runs)}")
    broken = sum(any(run.violations for run in d.runs) for d in draws)
    print(f"violations {violations} in {broken} draws")
    print(f"exit 3 in {short:.1%} of the draws; runs by limit: {dict(limits.most_common()) or 'none'}")
    answered = [run for run in runs if not run.refused]
    for name in ("pixel", "ee"):
        print(f"{name:5} {_figures(answered, name)}")
    for who, seconds in (
        ("product", [sum(run.seconds for run in d.runs) for d in draws]),
        ("judge", [d.judge_seconds for d in draws]),
    ):
        if seconds:
            print(f"{who:7} s per draw: median {statistics.median(seconds):.2f}, largest {max(seconds):.1f}")
    return not violations and short <= MOST_SHORT and len(draws) == len(found)


def _figures(runs: list[Kept], name: str) -> str:
    cases = [tuple(getattr(part, name) for part in (run.asked, run.told, run)) for run in runs if name not in run.short]
    worst = max((true / asked for asked, _, true in cases), default=0.0)
    seen = [told / true for asked, told, true in cases if true > max(asked / 100.0, NOTHING)]
    middle = f"median told/true {statistics.median(seen):.2g} of {len(seen)}" if seen else "no error to speak of"
    return f"worst true/asked {worst:.2g}, {middle}"


def examine_all(seed: int, numbers: Iterable[int], jobs: int, limit: float) -> list[Draw | Broken]:
    """All draws, told on stderr as they come."""
    found = []
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(draw, seed, number, limit) for number in numbers]
        for done, future in enumerate(as_completed(waiting), start=1):
            found.append(future.result())
            for line in lines(found[-1]):
                print(f"\r{line}", file=sys.stderr)
            print(f"\r{done} of {len(waiting)} draws", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return sorted(found, key=lambda d: d.number)


def main() -> int:
    """Examine the draws asked for; 1 if the promise is broken."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("draws", nargs="?", type=int, default=60, help="how many draws")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--only", type=int, metavar="K", help="one draw, told in full with its system file")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=float, default=300.0, help="processor seconds a draw may take")
    asked = parser.parse_args()
    if asked.only is not None:
        print(yaml.safe_dump(drawn(asked.seed, asked.only), sort_keys=False))
        verbose(one := draw(asked.seed, asked.only, asked.limit))
        return int(isinstance(one, Broken) or any(run.violations for run in one.runs))
    print(f"seed {asked.seed}, accuracies {', '.join(f'{a:.0e}' for a in ASKED)}")
    numbers = range(asked.first, asked.first + asked.draws)
    found = examine_all(asked.seed, numbers, asked.jobs, asked.limit)
    for line in [line for one in found for line in lines(one)]:
        print(line)
    return int(not summary(found))


if __name__ == "__main__":
    sys.exit(main())
