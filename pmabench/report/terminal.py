"""Tables of text for a terminal of any width: numbers are never cut or broken; computes nothing.

Where a table is wider than the terminal its heads and texts are wrapped; where that is not enough it is printed in
several parts, each beginning with the key columns.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from pmabench.base.text import printable

if TYPE_CHECKING:
    from rich.console import Console

GAP = "  "
TEXT = 12
"""A text is not squeezed into less than this."""


def print_grid(
    console: Console, heads: Sequence[str], rows: Sequence[Sequence[str]], texts: Collection[str] = (), keys: int = 1
) -> None:
    """Print `rows` under `heads`; columns in `texts` are left-justified and may be wrapped, the others hold numbers.

    The first `keys` columns are repeated in every part of a table that must be split. Signs that a terminal would obey
    become blanks.
    """
    from rich.text import Text

    columns = [[printable(head), *(printable(row[index]) for row in rows)] for index, head in enumerate(heads)]
    least = [_least(cells, text=head in texts) for head, cells in zip(heads, columns, strict=True)]
    whole = [max(map(len, cells)) for cells in columns]
    for number, part in enumerate(_parts(least, min(keys, len(heads)), console.width)):
        widths = _widths([least[i] for i in part], [whole[i] for i in part], console.width)
        if number:
            console.print()
        for line in range(len(rows) + 1):
            cells = [
                [text if heads[i] in texts else text.rjust(width) for text in _broken(columns[i][line], width)]
                for i, width in zip(part, widths, strict=True)
            ]
            for at in range(max(map(len, cells))):
                texts_of_line = [cell[at] if at < len(cell) else "" for cell in cells]
                padded = (text.ljust(width) for text, width in zip(texts_of_line, widths, strict=True))
                style = "bold" if line == 0 else ""
                console.print(Text(GAP.join(padded).rstrip(), style=style), soft_wrap=True)


def print_texts(console: Console, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """`print_grid` of columns that are all texts."""
    print_grid(console, heads, rows, heads)


def _least(cells: Sequence[str], *, text: bool) -> int:
    """The narrowest width of a column: numbers stay in one piece, words and heads break at blanks."""
    whole = [n > 0 and any(sign.isdigit() for sign in cell) for n, cell in enumerate(cells)]
    widths = [max(map(len, [cell] if one else cell.split()), default=0) for one, cell in zip(whole, cells, strict=True)]
    return min(max(widths), max(TEXT, widths[0])) if text else max(widths)


def _parts(least: Sequence[int], keys: int, width: int) -> list[list[int]]:
    """Indices of the columns of each part; a part has one column next to the keys, even where that is too wide."""
    first = list(range(keys))
    parts = [first]
    for index in range(keys, len(least)):
        part = [*parts[-1], index]
        if len(parts[-1]) > keys and sum(least[i] for i in part) + len(GAP) * (len(part) - 1) > width:
            parts.append([*first, index])
        else:
            parts[-1] = part
    return parts


def _widths(least: Sequence[int], whole: Sequence[int], width: int) -> list[int]:
    """The width of each column: the least width, and the remaining room for the first columns that need more."""
    left = width - sum(least) - len(GAP) * (len(least) - 1)
    widths = []
    for low, high in zip(least, whole, strict=True):
        more = max(0, min(high - low, left))
        left -= more
        widths.append(low + more)
    return widths


def _broken(cell: str, width: int) -> list[str]:
    return wrap(cell, max(width, 1)) or [""] if len(cell) > width else [cell]
