"""Options that several commands share."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from psfcli.cli.prices import price_tags
from psfcli.config import load
from psfcli.products import FORMATS
from psfcli.tolerance import PRESETS, Tolerance

_SIZES = {"kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40}


class Formats(click.ParamType[tuple[str, ...]]):
    """A comma-separated list of formats."""

    name = "list"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """The formats, each once, in the order of FORMATS."""
        if isinstance(value, tuple):
            return value
        asked = [part.strip() for part in str(value).split(",")]
        for part in asked:
            if part not in FORMATS:
                self.fail(f"{part!r} is no format; allowed: {', '.join(FORMATS)}", param, ctx)
        return tuple(name for name in FORMATS if name in asked)


class Amount(click.FloatRange):
    """A number in a range, and not nan, which lies in every one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number."""
        number = super().convert(value, param, ctx)
        return self.fail(f"{value} is no number", param, ctx) if math.isnan(number) else number


class MemorySize(click.ParamType[float]):
    """A number of bytes such as 4GB or 512MiB."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The size in bytes."""
        if isinstance(value, float):
            return value
        text = str(value).strip()
        for unit, factor in (*_SIZES.items(), ("B", 1.0), ("", 1.0)):
            if text.endswith(unit):
                try:
                    size = float(text[: len(text) - len(unit)]) * factor
                except ValueError:
                    continue
                if 0.0 < size < float("inf"):
                    return size
        return self.fail(f"{text!r} is no size; write a number of bytes or one such as 500MB, 4GB, 2GiB", param, ctx)

    @staticmethod
    def default() -> float:
        """Half of the machine's memory [bytes]."""
        return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


changes_system = click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Such as surfaces.0.psd.C=2."
)
"""Values of CONFIG replaced by dotted key; the command gets ``overrides``."""


def loads_system(command: Callable[..., Any]) -> Callable[..., Any]:
    """CONFIG and the options that change what it says; the command gets ``config`` and the ``system`` they make."""

    @functools.wraps(command)
    def with_system(
        config: str,
        overrides: tuple[str, ...],
        fields: tuple[str, ...],
        accuracy_name: str | None,
        pixel_error: float | None,
        ee_error: float | None,
        **others: Any,
    ) -> Any:
        system = load(config, overrides, fields or None, accuracy(accuracy_name, pixel_error, ee_error))
        return command(config=config, system=system, **others)

    decorated: Callable[..., Any] = with_system
    for decorate in reversed(
        (
            click.argument("config", metavar="CONFIG"),
            click.option("--field", "fields", multiple=True, metavar='"0.3 deg"', help="Replaces fields; repeatable."),
            changes_system,
            click.option(
                "--accuracy",
                "accuracy_name",
                type=click.Choice(list(PRESETS)),
                help=f"Replaces accuracy. {price_tags()}",
            ),
            click.option("--pixel-error", type=float, metavar="X", help="Relative error of a pixel, with --ee-error."),
            click.option(
                "--ee-error", type=float, metavar="Y", help="Error of an ensquared energy, with --pixel-error."
            ),
        )
    ):
        decorated = decorate(decorated)
    return decorated


def asks_for_products(command: Callable[..., Any]) -> Callable[..., Any]:
    """What is computed of the system, in how many processes and how much memory: run and plan say the same."""
    for decorate in reversed(
        (
            click.option("--format", "formats", type=Formats(), default=",".join(FORMATS), show_default=True),
            click.option(
                "--jobs",
                type=click.IntRange(1, 256),
                metavar="N",
                help="Processes, each a few fields at a time; default: as many as pay.",
            ),
            click.option(
                "--max-memory", type=MemorySize(), metavar="SIZE", help="Such as 4GB; default: half of the machine's."
            ),
        )
    ):
        command = decorate(command)
    return command


def writes_to(
    default: str, written: str, quiet: str = "Nothing on stderr but errors."
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """The directory of what is ``written`` and its ``default`` as the help says them, and how ``quiet`` it is done.

    The command gets ``output``, ``overwrite`` and ``quiet``.
    """

    def decorator(command: Callable[..., Any]) -> Callable[..., Any]:
        for decorate in reversed(
            (
                click.option(
                    "-o", "--output", type=click.Path(path_type=Path), metavar="DIR", help=f"Default: {default}."
                ),
                click.option("--overwrite", is_flag=True, help=f"Replace the {written} in DIR."),
                click.option("-q", "--quiet", is_flag=True, help=quiet),
            )
        ):
            command = decorate(command)
        return command

    return decorator


def directory_for(output: Path | None, source: str, ending: str) -> Path:
    """The directory asked for; by default the stem of the file ``source`` (- for standard input) with an ``ending``."""
    return output or Path(("stdin" if source == "-" else Path(source).stem) + ending)


def accuracy(name: str | None, pixel_error: float | None, ee_error: float | None) -> Tolerance | str | None:
    """The accuracy asked for; None: that of the system file. Raises UsageError for half a pair or both ways."""
    if (pixel_error is None) != (ee_error is None):
        raise click.UsageError("--pixel-error and --ee-error come together")
    if pixel_error is None or ee_error is None:
        return name
    if name is not None:
        raise click.UsageError("--accuracy excludes --pixel-error and --ee-error")
    return Tolerance(pixel_error, ee_error)
