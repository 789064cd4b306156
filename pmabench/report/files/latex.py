"""Tables of LaTeX without further packages: plain numbers, every text escaped; the same bytes for the same table."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pmabench.plotting.frame import Frame
from pmabench.plotting.svg import symbol_parts
from pmabench.plotting.wording import clean

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
    out = []
    for sign in marked:
        if sign in _ESCAPES:
            out.append(_ESCAPES[sign])
        elif sign in "\0\1":
            out.append("$^{" if sign == "\0" else "}$")
        else:
            out.append(sign if sign.isascii() or sign.isalpha() else "?")
    return "".join(out).replace("?`", "?{}`").replace("!`", "!{}`")


def typeset(text: object) -> str:
    """As `escaped`, with symbols of the field in mathematics: `F_ce [N]`."""
    out = ""
    for kind, part in symbol_parts(clean(text, 10_000)):
        if kind == "sub":
            out = out.removesuffix("$") + f"_\\mathrm{{{escaped(part)}}}$"
        elif kind == "symbol":
            known = _ESCAPES.get(part, part)
            out += f"${known.strip('$')}$"
        else:
            out += escaped(part)
    return out


def table(frame: Frame, caption: str, label: str, *, texts: Sequence[str] = ()) -> str:
    """A frame of text cells as one `table` with `tabular`; columns in `texts` are set left, the others right."""
    columns = frame.columns
    lines = [
        r"\begin{table}",
        rf"\caption{{{typeset(caption)}}}",
        rf"\label{{{re.sub(r'[^A-Za-z0-9:-]', '-', label)}}}",
        rf"\begin{{tabular}}{{{''.join('l' if c in texts else 'r' for c in columns)}}}",
        r"\hline",
        " & ".join(typeset(c) for c in columns) + r" \\",
        r"\hline",
        *(" & ".join(typeset(value) for value in row) + r" \\" for row in frame.cells()),
        r"\hline",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"
