"""Surfaces whose spectrum is measured: the files a system file names, fitted, and the fit put in their place."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from psfcli.config.faults import ConfigError, Faults, quoted
from psfcli.config.paths import follow, with_value
from psfcli.config.spectra import Stated, read_spectra
from psfcli.config.tree import Broken, Entry, Mapping, Node, Scalar, Sequence, atom
from psfcli.metrology.coverage import image_band, remark
from psfcli.metrology.measurement import GAIN_ERROR

if TYPE_CHECKING:
    from collections.abc import Iterator

    from psfcli.config.faults import Place
    from psfcli.config.model import System
    from psfcli.metrology.coverage import Band
    from psfcli.metrology.fit import Fit

NM3 = 1e18  # in a mm^3

Bands = dict[int, list["Band"]]
"""The bands [cycles/mm] that were measured of a surface, by its index."""


def with_fits(root: Node, values: Any, directory: Path, faults: Faults) -> tuple[Node, Bands]:
    """The tree with each `psd: {files: ...}` replaced by the fitted terms, and what was measured of each surface.

    ``values`` are the checked values of the tree, files are taken from ``directory``. The tree says the same surface
    without its files from then on. What is wrong with a file is told where the term stands.
    """
    bands: Bands = {}
    for i, surface in enumerate((values or {}).get("surfaces", [])):
        for j, term in reversed(list(enumerate((surface or {}).get("psd", [])))):
            if term is None or not term.keys() >= {"files", "terms"} or None in (term["files"] or [None]):
                continue
            node, steps = follow(root, ("surfaces", i, "psd", j))
            try:
                found = _fitted(term, directory)
            except ConfigError as error:
                for problem in error.faults:
                    faults.add(node.place, steps, problem)
                terms: tuple[Node, ...] = (Broken(node.place),)
            else:
                terms = tuple(_terms(found, node.place))
                bands.setdefault(i, []).extend(one.measurement.band for one in found.instruments)
            whole = ("surfaces", i, "psd")
            listed = follow(root, whole)[0]
            others: list[Node] = list(listed.items) if isinstance(listed, Sequence) else [listed]
            others[j : j + 1] = terms
            root = with_value(root, whole, Sequence(listed.place, tuple(others)), listed.place)
    return root, bands


def image_bands(system: System) -> dict[int, Band]:
    """The spatial frequencies [cycles/mm] of each surface, by its index, that light of the detector's window uses.

    From one pixel to the farthest corner, at all wavelengths.
    """
    near, far = system.detector.pixel, system.detector.farthest()
    distances = [system.telescope.magnified_distance(surface.marginal_height) for surface in system.surfaces]
    return {i: image_band(near, far, system.wavelengths, d) for i, d in enumerate(distances)}


def unmeasured(system: System, bands: Bands) -> Iterator[str]:
    """Remarks on surfaces whose image uses spatial frequencies that lie in none of the ``bands`` measured of them."""
    for i, used in image_bands(system).items():
        said = remark(bands[i], used) if i in bands else ""
        if said:
            yield f"surfaces[{i}] ({system.surfaces[i].name}): {said}"


def psd_terms(found: Fit) -> list[dict[str, str]]:
    """The terms of a fit as keys of a system file and what stands under them, to ten digits."""
    return [
        {"A": f"{NM3 * math.exp(ln_A):.10g} nm3", "B": f"{math.exp(ln_B):.10g} mm", "C": f"{C:.10g}"}
        for ln_A, ln_B, C in found.parameters.tolist()
    ]


def psd_block(found: Fit) -> str:
    """The fit as the `psd` of a surface, ready for a system file, and a comment that says where it comes from."""
    terms = [", ".join(f"{key}: {text}" for key, text in words.items()) for words in psd_terms(found)]
    says = f"# K-correlation fitted to {', '.join(quoted(one.measurement.name) for one in found.instruments)}\n"
    if len(terms) == 1:
        return f"{says}psd: {{{terms[0]}}}"
    return f"{says}psd:\n" + "\n".join(f"  - {{{term}}}" for term in terms)


def _fitted(term: dict[str, Any], directory: Path) -> Fit:
    """The fit of a checked term that names files; raises ConfigError."""
    stated = Stated(term.get("kind", ""), term.get("frequency_unit", ""), term.get("psd_unit", ""))
    spectra = read_spectra([directory / name for name in term["files"]], stated)
    # numpy and scipy: for those who have files
    from psfcli.metrology.fit import fit
    from psfcli.metrology.resolution import FitError

    try:
        return fit(spectra, term["terms"], term.get("gain_error", GAIN_ERROR))
    except FitError as error:
        raise ConfigError([str(error)]) from None


def _terms(found: Fit, place: Place) -> Iterator[Mapping]:
    for words in psd_terms(found):
        values = {key: Scalar(place, text, atom(text)) for key, text in words.items()}
        yield Mapping(place, place, {key: Entry(place, value) for key, value in values.items()})
