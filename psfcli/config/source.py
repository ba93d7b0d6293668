"""The text of a system file, or of a file it names, from a path or from standard input."""

from __future__ import annotations

import sys
from pathlib import Path

from psfcli.config.faults import ConfigError

LARGEST = 2**21
"""Bytes: ten thousand fields, each with its azimuth, take less than half of this."""


def read(source: str | Path, wanted: str = "a system file") -> tuple[str, str]:
    """The name used in messages and the text of a file; ``-`` is standard input, ``wanted`` what it should be.

    Raises ConfigError when there is no such file, or it cannot be read, or is not UTF-8 text.
    """
    name = "<stdin>" if str(source) == "-" else str(source)
    if not name:
        raise ConfigError([f"'': no such file; {wanted} is wanted"])
    try:
        if name == "<stdin>":
            data = sys.stdin.buffer.read(LARGEST + 1)
        else:
            with Path(source).open("rb") as file:
                data = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise ConfigError([f"{name}: no such file"]) from None
    except IsADirectoryError:
        raise ConfigError([f"{name}: is a directory; {wanted} is wanted"]) from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise ConfigError([f"{name}: cannot be read: {getattr(error, 'strerror', None) or error}"]) from None
    if len(data) > LARGEST:
        raise ConfigError([f"{name}: larger than {LARGEST // 2**20} MiB; {wanted} is wanted"])
    try:
        return name, data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8-sig")
        line, column = line_and_column(before, len(before))
        problem = f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8 text"
        raise ConfigError([f"{name}:{line}:{column}: {problem}"]) from None


def line_and_column(text: str, position: int) -> tuple[int, int]:
    """The 1-based line and column of the character at ``position``."""
    before = text[:position]
    return before.count("\n") + 1, position - before.rfind("\n")
