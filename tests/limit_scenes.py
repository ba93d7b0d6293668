"""Scenes at the limits of the whole pipeline: for the tests that hold them and for the page that measures them."""

from __future__ import annotations

import copy
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

import psfcli

if TYPE_CHECKING:
    from psfcli.products.arrays import Result

Changes = dict[str, Any]
"""Other values at dotted keys of the paper's scene; __ stands for the dot."""

PAPER: dict[str, Any] = {
    "schema": 1,
    "wavelengths": ["9.4 nm"],
    "telescope": {
        "focal_length": "1750 mm", "aperture_diameter": "190 mm", "obscuration": 0.48, "max_field": "0.5 deg",
        "seidel": {"reference_wavelength": "9.4 nm", "W020": -30.35, "W040": 0.42, "W131": -7.6, "W222": 48.34,
                   "W220": 38.58, "W311": -5.48},
    },
    "surfaces": [
        {"marginal_height": "95 mm", "psd": {"sigma": "0.682 nm", "B": "1 mm", "C": 1.8}},
        {"marginal_height": "34.99 mm", "psd": {"sigma": "0.5 nm", "B": "1 mm", "C": 1.8}},
    ],
    "fields": ["0.3 deg"],
    "detector": {"pixel": "21 um", "pixels": 8, "oversample": 3},
    "ensquared_energy": {"half_widths": ["1 um", "10 um", "1 mm", "10 mm"]},
}  # fmt: skip
ENERGIES = ("ee", "ee_chief", "ee_centroid", "ee_unaberrated")


def scene(**changes: Any) -> dict[str, Any]:
    """The paper's telescope with the changes."""
    made = copy.deepcopy(PAPER)
    for key, value in changes.items():
        *path, last = key.split("__")
        section: Any = made
        for step in path:
            section = section[int(step) if step.isdigit() else step]
        section[last] = value
    return made


def loaded(**changes: Any) -> psfcli.System:
    """The system of the scene with the changes."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "scene.yaml"
        path.write_text(yaml.safe_dump(scene(**changes)))
        return psfcli.load(path)


def apart(a: Result, b: Result) -> tuple[float, float]:
    """The largest differences of pixels, relative but for the allowance of both, and of energies."""
    excess = np.maximum(np.abs(a.psf - b.psf) - 2e-5, 0.0) / b.psf
    faint = np.minimum(a.psf, b.psf) < 1e-3 * b.psf.max()  # where no unscattered light is near
    excess[faint] = np.maximum(excess[faint], np.abs(a.psf[faint] / b.psf[faint] - 1.0))
    energy = max(float(np.max(np.abs(a.ensquared_energy[name] - b.ensquared_energy[name]))) for name in ENERGIES)
    return float(excess.max()), energy


class Approach(NamedTuple):
    """Ever closer to a limit: what varies and its ``values``, the changes they make, and those of the limit."""

    what: str
    values: tuple[str, ...]
    near: tuple[Changes, ...]
    limit: Changes


def _approach(what: str, key: str, *values: Any, limit: Changes | None = None) -> Approach:
    """``values`` of a key; the last one is the limit, unless ``limit`` is another."""
    near = values if limit else values[:-1]
    told = tuple(value[0] if isinstance(value, list) else str(value) for value in near)
    return Approach(what, told, tuple({key: value} for value in near), limit or {key: values[-1]})


_SMOOTH_PRIMARY: Changes = {"surfaces__0__psd__sigma": "0 nm"}
_SMOOTH_SECONDARY: Changes = {"surfaces__1__psd__sigma": "0 nm"}
_DEFOCUS_ALONE = (1e-1, 1e-3, 1e-6, 0.0)

# within what can be asked for: what is close agrees, what is closer agrees better; each step at least ten times closer
CONTINUOUS: dict[str, Approach] = {
    "C -> 1": _approach("C", "surfaces__0__psd__C", 1.01, 1.0001, 1.000001, 1.00000001),
    "C -> 2 from below": _approach("C", "surfaces__0__psd__C", 1.99, 1.999, 1.999999, 2.0),
    "C -> 2 from above": _approach("C", "surfaces__0__psd__C", 2.01, 2.001, 2.000001, 2.0),
    "C -> 3 from below": _approach("C", "surfaces__0__psd__C", 2.99, 2.999, 2.999999, 3.0),
    "C -> 3 from above": _approach("C", "surfaces__0__psd__C", 3.01, 3.001, 3.000001, 3.0),
    "obscuration -> 1": _approach("obscuration", "telescope__obscuration", 0.9, 0.99, 0.9999, 0.9999999999999999),
    "wavelength": _approach("wavelength", "wavelengths", ["9.5 nm"], ["9.41 nm"], ["9.4001 nm"], ["9.4 nm"]),
    "TIS -> 0": _approach("sigma", "surfaces__0__psd__sigma", "1e-2 nm", "1e-4 nm", "1e-8 nm", "0 nm"),
    "aberration -> 0": Approach(
        "W020 alone, in waves",
        tuple(f"{W:g}" for W in _DEFOCUS_ALONE[:-1]),
        tuple({"telescope__seidel": {"reference_wavelength": "9.4 nm", "W020": W}} for W in _DEFOCUS_ALONE[:-1]),
        {"telescope__seidel": {"reference_wavelength": "9.4 nm", "W020": _DEFOCUS_ALONE[-1]}},
    ),
}
# B -> 0: what lies below 1/lambda is sigma^2 (B/lambda)^2 nu
FAST = _approach("B", "surfaces__0__psd__B", "100 nm", "10 nm", "1 nm", limit=_SMOOTH_PRIMARY)
# B -> infinity: the core narrows until it is no blur
SLOW = _approach("B", "surfaces__0__psd__B", "100 mm", "1 m", "10 m", limit=_SMOOTH_PRIMARY)
# h2/h1 -> 0: a surface moves into the image
INTO_THE_IMAGE = _approach(
    "h2", "surfaces__1__marginal_height", "34.99 mm", "1 mm", "30 um", "1 nm", limit=_SMOOTH_SECONDARY
)
APPROACHES: dict[str, Approach] = {
    **CONTINUOUS,
    "B -> 0: no scatter": FAST,
    "B -> infinity: no blur": SLOW,
    "h2/h1 -> 0: a point": INTO_THE_IMAGE,
}


def enormous(factor: float) -> Changes:
    """All aberrations of the paper times a factor."""
    table = PAPER["telescope"]["seidel"]
    return {
        "telescope__seidel": {name: factor * value if name.startswith("W") else value for name, value in table.items()}
    }


# what the judge of the tests knows the truth of
_SQUARES: Changes = {"ensquared_energy": {"half_widths": ["10 um", "1 mm", "300 mm"]}}
JUDGED: dict[str, Changes] = {
    name: {**_SQUARES, **changes}
    for name, changes in {
        "no limit: the paper's telescope": {},
        "C = 1.00000001": {"surfaces__0__psd__C": 1.00000001},
        "C = 2": {"surfaces__0__psd__C": 2.0},
        "C = 3": {"surfaces__0__psd__C": 3.0},
        "C = 10": {"surfaces__0__psd__C": 10.0},
        "B = 1 nm": {"surfaces__0__psd__B": "1 nm"},
        "sigma = 0": _SMOOTH_PRIMARY,
        "sigma = 8 nm: all light scattered": {"surfaces__0__psd__sigma": "8 nm"},
        "obscuration = 1 - 1e-16": CONTINUOUS["obscuration -> 1"].limit,
        "no aberration": CONTINUOUS["aberration -> 0"].limit,
        "aberrations times 30": enormous(30.0),
        "a pixel of 1 m": {"detector": {"pixel": "1 m", "pixels": 1, "oversample": 1}},
        "pixels of 100 mm": {"detector": {"pixel": "100 mm", "pixels": 8, "oversample": 1}},
        "pixels of 1 nm": {"detector": {"pixel": "1 nm", "pixels": 8, "oversample": 1}},
    }.items()
}
FACTORS = (30.0, 300.0, 2e4)
"""Of aberrations that draft images end with, of one sub-pixel; the last has spots of a metre."""
DRAFT: Changes = {"accuracy": "draft", "detector__oversample": 1}

# outside what the model means, or what can be computed, and why
REFUSED: dict[str, tuple[Changes, str]] = {
    "C = 100": ({"surfaces__0__psd__C": 100.0}, r"C = 100 and a total phase variance of .* beyond what the mixture"),
    "C = 1000": ({"surfaces__0__psd__C": 1000.0}, r"C = 1000 and a total phase variance of .* beyond what the mixture"),
    "sigma = 100 nm": ({"surfaces__0__psd__sigma": "100 nm"}, r"total phase variance of 1\.\d+e\+04 is beyond"),
    "64 x 64 pixels of 1 m": (
        {"detector": {"pixel": "1 m", "pixels": 64, "oversample": 1}},
        "the window reaches .* no light lands beyond .* --format csv would do",
    ),
}

COUNT = 10_000
MANY_FIELDS: Changes = {
    "fields": {"start": "-0.5 deg", "stop": "0.5 deg", "count": COUNT},
    "accuracy": "draft",
    "telescope__seidel": {"reference_wavelength": "9.4 nm", "W020": -30.35, "W220": 38.58},
    "ensquared_energy": {"half_widths": ["10 um"]},
}
