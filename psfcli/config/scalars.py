"""Single values: what each kind accepts, and what it says of the others."""

from __future__ import annotations

import difflib
import math

from psfcli.config.kinds import Number, Quantity, Text, Word
from psfcli.config.table import MOST_PIXELS
from psfcli.config.tree import Scalar, atom
from psfcli.config.units import Pixels, convert, mistaken


def scalar(kind: Quantity | Number | Word | Text, node: Scalar) -> float | str:
    """The value of a scalar, in the unit used inside; raises ValueError with what is wrong."""
    match kind:
        case Quantity():
            return quantity(kind, node)
        case Number():
            return _number(kind, node)
        case Word():
            return _word(kind, node)
    return _text(node)


def quantity(kind: Quantity, node: Scalar) -> float:
    """The value of a quantity in the unit used inside; raises ValueError with what is wrong."""
    value = convert(node.text, kind.dimension, kind.unit)
    limits = (f"-{MOST_PIXELS} pix", f"{MOST_PIXELS} pix") if isinstance(value, Pixels) else (kind.low, kind.high)
    low, high = (convert(text, kind.dimension, kind.unit) for text in limits)
    if not low <= (abs(value) if kind.magnitude else value) <= high:
        of = "magnitudes " if kind.magnitude else ""
        why = f" ({kind.why})" if kind.why else ""
        allowed = f"{of}{limits[0]}..{limits[1]}{why}{mistaken(node.text)}"
        raise ValueError(f"{node.shown} is out of range; allowed: {allowed}")
    return value


def span(kind: Number) -> str:
    """The range of a number in words."""
    if kind.low == kind.high:
        return f"{kind.low:g}"
    if not kind.beyond and not kind.below:
        return f"{kind.low:g}..{kind.high:g}"
    return f"{'above' if kind.beyond else 'from'} {kind.low:g}, {'below' if kind.below else 'up to'} {kind.high:g}"


def _number(kind: Number, node: Scalar) -> float | int:
    what = "whole number" if kind.whole else "number"
    if isinstance(node.value, bool) or not isinstance(node.value, int if kind.whole else (int, float)):
        advice = "; remove the quotes" if node.style and isinstance(atom(node.text), int | float) else ""
        raise ValueError(f"{node.shown} is not a {what}; allowed: {span(kind)}{advice}")
    if isinstance(node.value, float) and not math.isfinite(node.value):
        raise ValueError(f"{node.shown} is not finite; allowed: {span(kind)}")
    above = kind.low < node.value or (not kind.beyond and node.value == kind.low)
    under = node.value < kind.high or (not kind.below and node.value == kind.high)
    if not (above and under):
        raise ValueError(f"{node.shown} is out of range; allowed: {span(kind)}")
    return node.value if kind.whole else float(node.value)


def _word(kind: Word, node: Scalar) -> str:
    if node.text not in kind.words:
        close = difflib.get_close_matches(node.text.lower(), kind.words, 1)
        advice = f"; did you mean {close[0]}?" if close else ""
        raise ValueError(f"{node.shown} is unknown; allowed: {', '.join(kind.words)}{advice}")
    return node.text


def _text(node: Scalar) -> str:
    if not isinstance(node.value, str):
        raise ValueError(f"{node.shown} is not text; put it in quotes")
    if not node.value.strip().isprintable():
        raise ValueError(f"{node.shown} has line breaks or control characters; write one plain line")
    return node.value.strip()
