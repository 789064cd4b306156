"""Makes texts from outside harmless for terminals, pages and spreadsheets."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any, TextIO

_OBEYED = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb]"
    r"|[\U000e0000-\U000e007f]"
)
"""Control characters of a terminal, and characters that hide or reverse the text after them; not new lines and tabs."""
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff]")


def printable(text: object, longest: int | None = None) -> str:
    """One line for a terminal or a comment: control and invisible characters become blanks."""
    return _cut("".join(sign if sign.isprintable() else " " for sign in str(text)), longest)


def clean(text: object, longest: int = 2000) -> str:
    """Text for a page, lines kept: without control and direction characters, cut if too long."""
    text_only = str(text)
    if not text_only.isprintable():
        text_only = _CONTROL.sub("", text_only.replace("\r", "").encode("utf-8", "replace").decode("utf-8"))
    return _cut(text_only, longest)


def spelled(text: str) -> str:
    r"""Text for a terminal, lines kept: control characters are shown as in source code.

    >>> print(spelled("a name\x1b[31m"))
    a name\x1b[31m
    """
    return _OBEYED.sub(lambda sign: ascii(sign[0])[1:-1], text)


class Spelled:
    """Standard output or standard error on which every text is `spelled`, so that it contains no control characters.

    The program's own control sequences (colours, positions) are written to its `raw` stream.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str | bytes) -> int:
        """As for the stream; bytes, which click writes for completion with Tab, are UTF-8."""
        self.stream.write(spelled(text if isinstance(text, str) else text.decode("utf-8", "replace")))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """As for the stream."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        """Other attributes of the stream, except those that would bypass `write`."""
        if name == "buffer":
            raise AttributeError(name)
        return getattr(self.stream, name)


def raw(stream: Any) -> TextIO:
    """The underlying stream, for the program's own control sequences; its users must clean foreign text."""
    found: TextIO = stream.stream if isinstance(stream, Spelled) else stream
    return found


_ASCII = {
    **dict(zip("▁▂▃▄▅▆▇█", "__.--=##", strict=True)),
    **dict.fromkeys("─━–—−‐‑", "-"),
    **dict.fromkeys("·×", "*"),
    **dict.fromkeys("│┃", "|"),
    "±": "+-", "…": "...", "²": "2", "³": "3", "µ": "u", "μ": "u", "°": "deg", "Ω": "Ohm", "′": "'", "″": "''",
    "≤": "<=", "≥": ">=", "→": "->", "\u00a0": " ", "\u202f": " ",
}  # fmt: skip
"""Signs that this program prints, for a terminal that has ASCII only."""


def in_ascii(error: UnicodeError) -> tuple[str, int]:
    r"""An error handler of `codecs`: signs in ASCII, others as in source code. A half width takes the blank after it,
    so that columns keep their width.

    >>> import codecs
    >>> codecs.register_error("in-ascii", in_ascii)
    >>> "113.0 ± 1.9 N·m ä".encode("ascii", "in-ascii")
    b'113.0 +-1.9 N*m \\xe4'
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    signs, end = error.object[error.start : error.end], error.end
    text = "".join(_ASCII.get(sign) or ascii(sign)[1:-1] for sign in signs)
    return text, end + (signs[-1] == "±" and error.object[end : end + 1] == " ")


def unused(stem: str, taken: set[str], ending: str = "") -> str:
    """`stem` and `ending`, with a number between them if that is in `taken`, ignoring case; added to `taken`."""
    name, count = f"{stem}{ending}", 1
    while name.casefold() in taken:
        count += 1
        name = f"{stem}-{count}{ending}"
    taken.add(name.casefold())
    return name


def _cut(text: str, longest: int | None) -> str:
    return text if longest is None or len(text) <= longest else text[: longest - 1] + "…"


LEVELS = "▁▂▃▄▅▆▇█"
NONE = " "


def sparkline(values: Sequence[float], width: int = 60) -> str:
    """Text of at most `width` block characters for `values` in order; each shows the median of its part, or a blank."""
    if not values:
        return ""
    count = min(width, len(values))
    parts = [values[k * len(values) // count : (k + 1) * len(values) // count] for k in range(count)]
    middles = [sorted(good)[len(good) // 2] if (good := [v for v in part if isfinite(v)]) else None for part in parts]
    known = [v for v in middles if v is not None]
    low, span = (min(known), max(known) - min(known)) if known else (0.0, 0.0)
    return "".join(
        NONE if v is None else LEVELS[min(7, int((v - low) / span * 8))] if span > 0 else LEVELS[0] for v in middles
    )
