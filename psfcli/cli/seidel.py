"""``psfcli seidel``: the aberrations of each surface and of the whole, and the first-order optics beneath them."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from typing import TYPE_CHECKING

import click

from psfcli.cli.speaking import tell_warnings
from psfcli.config import load
from psfcli.telescope.paraxial import ParaxialTrace, trace
from psfcli.telescope.seidel import SeidelTable
from psfcli.telescope.seidel_sums import defocus, petzval_radius, surface_tables

if TYPE_CHECKING:
    from psfcli.config import System

_COEFFICIENTS = tuple(f.name for f in fields(SeidelTable))
_COLUMNS = ("surface", "y_mm", "ybar_mm", "i_deg", "ibar_deg", "d_mm", *_COEFFICIENTS)
_TOTAL, _DETECTOR = "total", "detector"

Row = dict[str, float | str]
"""A surface, the detector or the total: values of ``_COLUMNS``, those there are."""


@click.command()
@click.argument("config", metavar="CONFIG")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Such as prescription.stop=secondary.")
@click.option("--format", "as_", type=click.Choice(["text", "csv"]), default="text", help="Default: text.")
def command(config: str, overrides: tuple[str, ...], as_: str) -> None:
    """Print the Seidel table of each surface and of the whole telescope of CONFIG (- for standard input).

    In waves of the first wavelength, at the pupil's rim and max_field; with the heights of the marginal and the chief
    ray, their angles of incidence and the distance from which each surface scatters; and what is of first order. A
    file without a prescription has the total, the marginal heights and the distances alone. csv: the table alone.
    """
    system = load(config, overrides)
    tell_warnings(system)
    found = trace(system.prescription, system.telescope.max_field) if system.prescription else None
    rows = list(_rows(system, found))
    if as_ == "csv":
        table = csv.DictWriter(sys.stdout, _COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
        return
    lines = [system.title, ""] if system.title else []
    for name, value in _first_order(system, found):
        lines.append(f"{name:22}  {value}")
    lines += ["", *_text_table(rows, ("y_mm", "ybar_mm", "i_deg", "ibar_deg", "d_mm"), lambda v: f"{v:.6g}")]
    lines += ["", f"wavefront at the rim and max_field, in waves of {1e6 * system.wavelengths[0]:.6g} nm"]
    click.echo("\n".join([*lines, *_text_table(rows, _COEFFICIENTS, lambda v: f"{round(v, 4) + 0.0:.4f}")]))


def _rows(system: System, found: ParaxialTrace | None) -> Iterator[Row]:
    telescope, wave = system.telescope, system.wavelengths[0]
    if found is None:
        for plain in system.surfaces:
            d = telescope.magnified_distance(plain.marginal_height)
            yield {"surface": plain.name, "y_mm": plain.marginal_height, "d_mm": d}
    else:
        tables = surface_tables(found)
        for j, (surface, table) in enumerate(zip(found.prescription.surfaces, tables, strict=True)):
            i, ibar = found.incidences[j]
            y = found.marginal.heights[j]
            yield {
                "surface": surface.name,
                "y_mm": y,
                "ybar_mm": found.chief.heights[j] + 0.0,
                "i_deg": math.degrees(i) + 0.0,
                "ibar_deg": math.degrees(ibar) + 0.0,
                "d_mm": telescope.magnified_distance(y),
                **_waves(table, wave),
            }
        yield {"surface": _DETECTOR, **_waves(defocus(found), wave)}
    yield {"surface": _TOTAL, **_waves(telescope.seidel, wave)}


def _waves(table: SeidelTable, wave: float) -> dict[str, float]:
    return {name: length / wave + 0.0 for name, length in asdict(table).items()}  # + 0.0: no minus before a zero


def _text_table(rows: list[Row], columns: tuple[str, ...], form: Callable[[float], str]) -> Iterator[str]:
    """The columns of which any row has a value, right-aligned beside the names; rows without any are left out."""
    shown = [column for column in columns if any(row.get(column) is not None for row in rows)]
    width = max(len("surface"), *(len(str(row["surface"])) for row in rows))
    heads = [column.replace("_mm", " [mm]").replace("_deg", " [deg]") for column in shown]
    yield "  ".join([f"{'surface':{width}}", *(f"{head:>11}" for head in heads)])
    for row in rows:
        values = [row.get(column) for column in shown]
        if any(value is not None for value in values):
            cells = ["-" if value is None else form(float(value)) for value in values]
            yield "  ".join([f"{row['surface']:{width}}", *(f"{cell:>11}" for cell in cells)])


def _first_order(system: System, found: ParaxialTrace | None) -> Iterator[tuple[str, str]]:
    telescope = system.telescope
    u = telescope.image_slope
    if telescope.focal_length is not None:
        yield "focal length", f"{telescope.focal_length:.7g} mm"
        yield "plate scale", f"{math.degrees(3600.0 / telescope.focal_length):.6g} arcsec/mm"
    elif found is not None:
        yield "focal length", "infinite" if abs(found.power) < 1e-15 else f"{1.0 / found.power:.7g} mm"
        yield "magnification", f"{found.image_height / telescope.max_field:.6g} in size"
    yield "f-number", f"{0.5 / u:.6g} (u' = {u:.6g})"
    if found is None:
        return
    yield "paraxial image", f"{_z(found.image_distance)} last vertex, {found.image_height:.6g} mm high at max_field"
    yield "detector", f"{found.prescription.image_shift:+.6g} mm along the light from there"
    yield "stop", found.prescription.surfaces[found.prescription.stop].name
    for name, (z, radius), vertex in (
        ("entrance pupil", found.entrance_pupil, "first"),
        ("exit pupil", found.exit_pupil, "last"),
    ):
        yield name, "at infinity" if math.isinf(z) else f"{_z(z)} {vertex} vertex, {2.0 * radius:.6g} mm across"
    yield "Petzval radius", f"{petzval_radius(found):.6g} mm (below 0: it bends towards the telescope)"
    yield "Lagrange invariant", f"{abs(found.lagrange_invariant):.6g} mm"


def _z(z: float) -> str:
    return f"z = {z + 0.0:.7g} mm from the"
