"""manifest.json: how the products of a directory came about. Its presence says that they are whole."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from psfcli.products.header import versions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from psfcli.products.header import RunHeader


def manifest(header: RunHeader, digests: Mapping[str, str], timings: Mapping[str, float]) -> bytes:
    """The manifest as JSON; ``digests`` holds the sha256 of each product by name."""
    content = {
        "command": header.command,
        "title": header.title,
        "versions": versions(),
        "accuracy": {"pixel": header.tolerance.pixel, "ee": header.tolerance.ee},
        "plan": header.plan,
        "timings": timings,
        "input": {"file": header.input_name, "sha256": header.input_sha256},
        "products": {name: {"sha256": digest} for name, digest in digests.items()},
    }
    return json.dumps(content, indent=2, ensure_ascii=False).encode() + b"\n"
