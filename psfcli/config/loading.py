"""From a system file and the options of a command to a checked system."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from psfcli.config.build import build
from psfcli.config.check import check
from psfcli.config.faults import Faults, Place
from psfcli.config.finding import Finding
from psfcli.config.growing import grow
from psfcli.config.measured import unmeasured, with_fits
from psfcli.config.options import with_options
from psfcli.config.paths import follow
from psfcli.config.prescription_rules import an_image_is_made
from psfcli.config.rules import RULES, warnings
from psfcli.config.source import read
from psfcli.config.table import SYSTEM
from psfcli.config.tree import Broken, Mapping, Node, Scalar
from psfcli.config.writing import written
from psfcli.tolerance import Tolerance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from psfcli.config.model import System


def load(
    source: str | Path,
    overrides: Sequence[str] = (),
    fields: Sequence[str] | None = None,
    tolerance: Tolerance | str | None = None,
    wavelength: str | None = None,
) -> System:
    """The system a file describes, in the units used inside; ``-`` is standard input.

    ``overrides`` are ``dotted.key=value`` strings, ``fields`` replace the file's (each a field as in the file), and
    ``tolerance`` replaces its accuracy, by name or by number; ``wavelength`` replaces its wavelengths.

    Raises ConfigError, with every fault, when the file or an option cannot be used, and TypeError for an option of
    the wrong type, such as one text in place of a list of them.
    """
    for option, given, example in (("overrides", overrides, "surfaces.0.psd.C=2"), ("fields", fields, "0.3 deg")):
        if isinstance(given, str) or not all(isinstance(text, str) for text in given or ()):
            raise TypeError(f'{option}: {given!r} is no list of texts; write for example ["{example}"]')
    if not isinstance(tolerance, str | Tolerance | None):
        raise TypeError(f'tolerance: {tolerance!r} is neither a name such as "draft" nor a Tolerance(pixel, ee)')
    name, text = read(source)
    faults = Faults()

    def locate(line: int, column: int) -> Place:
        return Place(0, line, column, f"{name}:{line}:{column}")

    root = grow(text, locate, faults)
    if isinstance(root, Scalar) and root.value is None:
        faults.add(locate(1, 1), (), "empty; a system file begins with schema: 1")
        root = Broken(root.place)
    if isinstance(root, Broken):
        faults.raise_if_any()
    if isinstance(root, Mapping):
        root = replace(root, key=locate(1, 1))  # what is missing at the top is told there
        tree = with_options(root, overrides, fields, tolerance, wavelength, faults)
    else:
        tree = root
    values = check(tree, SYSTEM, faults)
    tree, bands = with_fits(tree, values, Path() if str(source) == "-" else Path(source).parent, faults)
    if bands:
        values = check(tree, SYSTEM, faults)
    for rule in RULES if values is not None else ():
        for finding in rule(values):
            _tell(finding, tree, faults)
    telescope = {"telescope", "prescription"}
    if telescope <= (values or {}).keys() and faults.sections.isdisjoint(telescope):
        for finding in an_image_is_made(values):  # any fault may be the reason why there is none
            _tell(finding, tree, faults)
    faults.raise_if_any()
    system = build(values, text if tree is root else written(tree), tuple(warnings(values)))
    return replace(system, warnings=(*system.warnings, *unmeasured(system, bands))) if bands else system


def _tell(finding: Finding, tree: Node, faults: Faults) -> None:
    node, steps = follow(tree, finding.steps)
    place = node.key if finding.key and isinstance(node, Mapping) else node.place
    others = [follow(tree, path)[0].place for path in finding.against]
    blamed = max([place, *(other for other in others if other.option)])
    problem = f"{node.shown} {finding.problem}" if isinstance(node, Scalar) else finding.problem
    faults.add(blamed, (*steps, finding.key) if finding.key else steps, problem)
