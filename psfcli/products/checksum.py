"""The checksums of the FITS standard (section 4.4.2.7 and appendix J)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

_MODULUS = 2**32 - 1
_PUNCTUATION = frozenset(b":;<=>?@[\\]^_`")


def word_sum(values: NDArray[Any]) -> int:
    """The sum of the 32-bit words of a contiguous array of 8-byte numbers, whichever way round its bytes are.

    Swapping the bytes of 8-byte numbers swaps their two words too, so native values give the sum of the
    big-endian file, as long as they are native.
    """
    return int(values.reshape(-1).view(np.uint32).sum(dtype=np.uint64))


def byte_sum(data: bytes) -> int:
    """The sum of the big-endian 32-bit words of ``data``, which is filled up with zeros to a whole word."""
    return int(np.frombuffer(data + bytes(-len(data) % 4), dtype=">u4").sum(dtype=np.uint64))


def folded(total: int) -> int:
    """A sum of words in 32-bit ones' complement: 0 only for no words but zeros, else 1 to 2^32 - 1."""
    return (total - 1) % _MODULUS + 1 if total else 0


def encoded(total: int) -> str:
    """The 16 characters of a CHECKSUM card that bring an HDU whose words sum to ``total`` to minus zero.

    ``total`` counts the card itself as sixteen "0". Each byte of the complement becomes four characters that
    sum to it (and to four "0"), none of them punctuation; the whole is turned right by one place, which is
    where the words of a card's value begin.
    """
    columns = []
    for byte in (_MODULUS - folded(total)).to_bytes(4, "big"):
        quarter, rest = divmod(byte, 4)
        four = [quarter + rest + 48, quarter + 48, quarter + 48, quarter + 48]
        for i in (0, 2):
            while four[i] in _PUNCTUATION or four[i + 1] in _PUNCTUATION:
                four[i] += 1
                four[i + 1] -= 1
        columns.append(four)
    text = "".join(chr(column[i]) for i in range(4) for column in columns)
    return text[-1] + text[:-1]
