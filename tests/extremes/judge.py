"""What psfcli gives for the rows of a table, and how far that is off, in units of what is allowed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from psfcli.surface.autocovariance import both_parts
from psfcli.surface.bsdf import bsdf
from psfcli.surface.harvey_shack import relative_rms, surface_transfer_function, total_integrated_scatter
from psfcli.surface.psd import KCorrelation
from psfcli.surface.surface import Surface

from .grid import COLUMNS, Row

PROMISE = 1e-12  # relative, of every function but the BSDF
BSDF_PROMISE = {"any slope": 1e-8, "closed form": PROMISE}

_NOTHING = 2.0**-60  # less than any error a double can have: 1 exactly

Values = dict[str, np.ndarray]
Formula = Callable[..., Sequence[float]]


def mirror(sigma: float, B: float, C: float) -> Surface:
    """A mirror with one K-correlation term."""
    return Surface("mirror", 1.0, (KCorrelation(sigma, B, C),))


def _autocovariance(u: float, nu: float) -> Sequence[float]:
    return [part[0] for part in both_parts(np.array([u]), nu)]


def _transfer(sigma: float, B: float, C: float, wavelength: float, r: float) -> Sequence[float]:
    surface = mirror(sigma, B, C)
    return (
        relative_rms(surface, wavelength),
        total_integrated_scatter(surface, wavelength),
        surface_transfer_function(np.array([r]), surface, wavelength)[0],
    )


def _bsdf(beta: float, sigma: float, B: float, C: float, wavelength: float) -> Sequence[float]:
    return bsdf(np.array([beta]), mirror(sigma, B, C), wavelength)


PSFCLI: dict[str, Formula] = {"autocovariance": _autocovariance, "transfer": _transfer, "bsdf": _bsdf}


def evaluate(formula: Formula, table: str, rows: list[Row]) -> Values:
    """Each result's values at the rows of a table."""
    names, results = COLUMNS[table]
    found = np.array([formula(*(row[name] for name in names)) for row in rows])
    return dict(zip(results, found.T, strict=True))


def column(rows: list[Row], name: str) -> np.ndarray:
    """A column as an array."""
    return np.array([row[name] for row in rows])


def allowed(table: str, rows: list[Row]) -> Values:
    """The relative error each value may have.

    1e-12, the conditioning of a power u^nu and of an exponential told apart: times max(1, nu/100, |ln rho|) for rho and
    1 - rho, times max(1, |ln H|) for H. 1e-8 for a BSDF, 1e-12 for one in closed form.
    """
    if table == "bsdf":
        return {"bsdf": np.array([BSDF_PROMISE[str(row["region"])] for row in rows])}
    one = np.full(len(rows), PROMISE)
    with np.errstate(divide="ignore"):
        if table == "transfer":
            return {"sigma_rel": one, "tis": one, "transfer": one * np.maximum(1.0, -np.log(column(rows, "transfer")))}
        rho, complement = column(rows, "rho"), column(rows, "complement")
        log_rho = np.where(rho < 0.5, -np.log(rho), -np.log1p(-np.minimum(complement, 0.5)))
    both = one * np.maximum(1.0, np.maximum(column(rows, "nu") / 100.0, log_rho))
    both[(rho == 0.0) | (complement == 0.0)] = _NOTHING
    return {"rho": both, "complement": both}


def excess(found: np.ndarray, exact: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """The relative error in units of the allowed one; infinite for a nan and for a 0 that is none."""
    with np.errstate(all="ignore"):
        units = np.abs(found / exact - 1.0) / allowed
    units = np.where(exact == 0.0, np.where(found == 0.0, 0.0, np.inf), units)
    return np.where(np.isfinite(found), units, np.inf)


def errors(found: Values, table: str, rows: list[Row]) -> Values:
    """``excess`` of each result at each row."""
    permitted = allowed(table, rows)
    return {name: excess(values, column(rows, name), permitted[name]) for name, values in found.items()}
