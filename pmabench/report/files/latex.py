"""Tables of LaTeX without further packages: plain numbers, every text escaped; the same bytes for the same table."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pmabench.plotting.svg import symbol_parts
from pmabench.plotting.wording import Frame, clean

_ESCAPES = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    '"': "''",
    "|": r"\textbar{}",
    "−": "$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "°": r"$^\circ$",
    "ε": r"$\varepsilon$",
    "η": r"$\eta$",
    "θ": r"$\theta$",
    "φ": r"$\varphi$",
    "τ": r"$\tau$",
    "ω": r"$\omega$",
    "α": r"$\alpha$",
    "π": r"$\pi$",
    "\u202f": r"\,",
    "’": "'",
    "“": "``",
    "”": "''",
    "–": "--",
    "…": r"\ldots{}",
}
_RAISED = dict(zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True))


def escaped(text: object) -> str:
    """Any text so that TeX prints it and does nothing else; a sign that plain TeX lacks becomes `?`."""
    marked = re.sub(r"[\s]+", " ", clean(text, 10_000))
    marked = re.sub(f"[{''.join(_RAISED)}]+", lambda m: f"\0{''.join(_RAISED[sign] for sign in m[0])}\1", marked)
    known = _ESCAPES | {"\0": "$^{", "\1": "}$"}
    out = (known.get(sign, sign if sign.isascii() or sign.isalpha() else "?") for sign in marked)
    return "".join(out).replace("?`", "?{}`").replace("!`", "!{}`")


def typeset(text: object) -> str:
    """As `escaped`, with symbols of the field in mathematics: `F_ce [N]`."""
    out = ""
    for kind, part in symbol_parts(clean(text, 10_000)):
        if kind == "sub":
            out = out.removesuffix("$") + f"_\\mathrm{{{escaped(part)}}}$"
        elif kind == "symbol":
            out += f"${_ESCAPES.get(part, part).strip('$')}$"
        else:
            out += escaped(part)
    return out


COLUMN = 229.0
"""Width of a column [pt]: of `article` with two columns; that of IEEEtran is 252 pt."""
SIZES = (("footnotesize", 4.25), ("scriptsize", 3.98))
"""Sizes of text with the width of a digit of Computer Modern in them [pt]."""
GAP = 2.0
"""Half the space between columns [pt], `\\tabcolsep`."""
_WIDE = ((".,:;il'| []()·", 0.56), ("±×−mw%", 1.67), ("0123456789", 1.0), ("MWK", 2.06))
"""Signs with their width in digits."""
WRAPPED = 58.0
"""Width of a column of words that is broken into lines [pt]."""


def table(frame: Frame, caption: str, label: str, *, texts: Sequence[str] = ()) -> str:
    """A frame of text cells as `table`s with `tabular`, none wider than a column of a page.

    Columns in `texts` are set left, the others right. What is too wide becomes several tables: one for each method,
    then some of the columns each, the first repeated; long words are broken into lines.
    """
    whole = [(frame, caption)]
    methods = list(dict.fromkeys(frame["method"])) if "method" in frame.columns else []
    if len(methods) > 1 and _width(frame, texts, 0) > COLUMN:
        rows = {method: frame.where(cell == method for cell in frame["method"]) for method in methods}
        whole = [(part.without("method").filled(), f"{caption}; {name}") for name, part in rows.items()]
    elif len(methods) == 1 and len(frame.columns) > 2:
        whole = [(frame.without("method"), f"{caption}; {methods[0]}")]
    found = [part for one, words in whole for part in _narrow(one, words, texts)]
    labels = [label if n == 0 else f"{label}-{n + 1}" for n in range(len(found))]
    return "\n".join(_table(part, words, name, texts) for (part, words), name in zip(found, labels, strict=True))


def _narrow(frame: Frame, caption: str, texts: Sequence[str]) -> list[tuple[Frame, str]]:
    """The frame, or parts of its columns that fit, each with the first column."""
    if _width(frame, texts, len(SIZES) - 1) <= COLUMN or len(frame.columns) < 3:
        return [(frame, caption)]
    first, *rest = frame.columns
    parts: list[list[str]] = [[]]
    for column in rest:
        if parts[-1] and _width(frame.select([first, *parts[-1], column]), texts, 0) > COLUMN:
            parts.append([])
        parts[-1].append(column)
    words = [caption, *[f"{caption} (continued)"] * (len(parts) - 1)]
    return [(frame.select([first, *part]), text) for part, text in zip(parts, words, strict=True)]


def _width(frame: Frame, texts: Sequence[str], size: int) -> float:
    """Width of the tabular [pt] in one of `SIZES`."""
    digit = SIZES[size][1]
    columns = [max(_letters(text) for text in (c, *frame[c])) * digit for c in frame.columns]
    wide = [min(w, WRAPPED) if c in texts else w for c, w in zip(frame.columns, columns, strict=True)]
    return sum(wide) + 2 * GAP * len(wide)


def _letters(text: object) -> float:
    """Length of a text in digits of Computer Modern."""
    known = {sign: wide for signs, wide in _WIDE for sign in signs}
    words = clean(text, 10_000).replace("_", "")
    return sum(known.get(sign, 1.5 if sign.isupper() else 1.06) for sign in words)


def _table(frame: Frame, caption: str, label: str, texts: Sequence[str]) -> str:
    columns = frame.columns
    size = next((n for n in range(len(SIZES)) if _width(frame, texts, n) <= COLUMN), len(SIZES) - 1)
    wide = {c for c in columns if max(map(_letters, (c, *frame[c]))) * SIZES[size][1] > WRAPPED}
    looks = ["r" if c not in texts else rf"p{{{WRAPPED:.0f}pt}}" if c in wide else "l" for c in columns]
    lines = [
        r"\begin{table}",
        rf"\caption{{{typeset(caption)}}}",
        rf"\label{{{re.sub(r'[^A-Za-z0-9:-]', '-', label)}}}",
        rf"\{SIZES[size][0]}\setlength{{\tabcolsep}}{{{GAP:.0f}pt}}",
        rf"\begin{{tabular}}{{{''.join(looks)}}}",
        r"\hline",
        " & ".join(typeset(c) for c in columns) + r" \\",
        r"\hline",
        *(" & ".join(typeset(value) for value in row) + r" \\" for row in frame.cells()),
        r"\hline",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"
