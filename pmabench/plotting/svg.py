"""A matplotlib figure as an SVG element for HTML: same bytes for the same figure, no external references, text as text.

Converts the markup of symbols (`F_ce`); independent of the content of a figure.
"""

from __future__ import annotations

import hashlib
import importlib
import io
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("report.mplstyle")
SYMBOL = re.compile(
    r"(?<![\w-])(?P<base>[A-Za-z]|tau|phi|eta|eps|omega|theta|alpha)(?:_(?P<sub>[A-Za-z]{1,4}|\d))?(?![\w'’-])"
)
"""A symbol; without a subscript it counts only before a unit or an equals sign, or alone."""
PLACES = re.compile(r' (?:x|y|x1|x2|y1|y2|width|height|transform)="[^"]*"')
MARKS = re.compile(r'<use [^>]*style="(?P<style>[^"]*)"/>\s*(?:<use [^>]*style="(?P=style)"/>\s*)+')
"""Consecutive markers of the same style."""
UNITS = {"N", "s", "J", "V", "A", "m"}
"""Letters that are a unit, not a symbol, when they are alone."""
GREEK = {"tau": "τ", "phi": "φ", "eta": "η", "eps": "ε", "omega": "ω", "theta": "θ", "alpha": "α"}


def symbol_parts(text: str) -> list[tuple[str, str]]:
    """Split into (`text`, ...), (`symbol`, ...) and (`sub`, ...) pieces: `F_ce [N]` -> symbol F, sub ce, text."""
    pieces: list[tuple[str, str]] = []
    end = 0
    for found in SYMBOL.finditer(text):
        base, sub = found["base"], found["sub"]
        rest = text[found.end() :]
        whole = found.start() == 0 and (rest.startswith(", ") or (rest[:1] in ("", "/") and base not in UNITS))
        lone = whole or rest.startswith((" [", " = ", " over "))
        if sub is None and base not in GREEK and not lone:
            continue
        pieces += [("text", text[end : found.start()]), ("symbol", GREEK.get(base, base))]
        if sub:
            pieces.append(("sub", sub))
        end = found.end()
    pieces.append(("text", text[end:]))
    return [(kind, part) for kind, part in pieces if part]


_inside: ContextVar[bool] = ContextVar("inside", default=False)
_lean: ContextVar[bool] = ContextVar("lean", default=False)


@contextmanager
def drawing() -> Iterator[None]:
    """Context with the style of reports, independent of local matplotlib settings; nested contexts have no effect."""
    if _inside.get():
        yield
        return
    if _lean.get():
        _import_what_draws()
    from matplotlib import style

    with style.context(["default", str(STYLE)]):
        before = _inside.set(True)
        try:
            yield
        finally:
            _inside.reset(before)


def draw_lean() -> None:
    """From now on draw without the 3D axes and the help texts of matplotlib, whose import takes as long as ten figures.

    For commands only: in a notebook other code may need them.
    """
    _lean.set(True)


def _import_what_draws() -> None:
    name = "mpl_toolkits.mplot3d"
    if "matplotlib.projections" in sys.modules or name in sys.modules:
        return
    artist: Any = importlib.import_module("matplotlib.artist")
    described = artist.kwdoc
    sys.modules[name] = None  # type: ignore[assignment]  # an import that fails, and of which matplotlib warns
    try:
        artist.kwdoc = lambda _class: ""
        with warnings.catch_warnings(action="ignore"):
            importlib.import_module("matplotlib.projections")
    finally:
        artist.kwdoc = described
        del sys.modules[name]


def to_svg(figure: Figure, alt: str) -> str:
    """The figure as one `<svg>` element with `alt` as its description; to be called inside `drawing()`."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    canvas: Any = FigureCanvasSVG(figure)
    buffer = io.StringIO()
    canvas.print_svg(buffer, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = lean(text)
    text = re.sub(r"font-family: [^;\"]*; ?", "", text).replace("<g/>\n", "")
    text = re.sub(r"(<text[^>]*>)([^<]*)(</text>)", lambda m: m[1] + marked(m[2]) + m[3], text)
    mark = hashlib.sha256((alt + text).encode()).hexdigest()[:8]
    text = re.sub(r'(id="|href="#|url\(#)', lambda m: f"{m[1]}f{mark}-", text)
    box = re.search(r'viewBox="[^"]*"', text)
    name = f"f{mark}-alt"
    head = f'<svg {box[0] if box else ""} role="img" aria-labelledby="{name}"><desc id="{name}">{escape(alt)}</desc>'
    return head + re.sub(r"\n\s*", "\n", text[text.index(">") + 1 :]).strip()


def as_file(svg: str, font: str) -> str:
    """The SVG element as a separate file: sizes in points (1/72 in), text in `font`, on white."""
    box = re.search(r'viewBox="\S+ \S+ (\S+) ([^" ]+)"', svg)
    size = f'width="{box[1]}pt" height="{box[2]}pt" ' if box else ""
    look = f'font-family="{font}" style="background: #fff"'
    return svg.replace("<svg ", f'<svg xmlns="http://www.w3.org/2000/svg" {size}{look} ', 1)


def lean(text: str) -> str:
    """The same drawing in fewer characters: two decimals, relative paths, short names, equal markers grouped."""
    found = re.findall(r'<[a-zA-Z][^>]* id="([^"]*)"', text)
    names = {name: f"{n:x}" for n, name in enumerate(dict.fromkeys(found))}

    def tag(match: re.Match[str]) -> str:
        shorter = re.sub(r' d="([^"]*)"', lambda m: f' d="{shortened(m[1])}"', match[0])
        shorter = re.sub(r' transform="rotate\(-?0 [^)]*\)"', "", shorter)
        shorter = PLACES.sub(
            lambda m: re.sub(r"-?\d+\.\d+", lambda n: _number(round(100 * float(n[0]))), m[0]), shorter
        )
        return re.sub(r'(id="|href="#|url\(#)([^")]*)', lambda m: m[1] + names.get(m[2], m[2]), shorter)

    return MARKS.sub(_marks, re.sub(r"<[a-zA-Z][^>]*>", tag, text))


def _marks(run: re.Match[str]) -> str:
    return f'<g style="{run["style"]}">\n' + re.sub(r' style="[^"]*"', "", run[0]) + "</g>\n"


def shortened(path: str) -> str:
    """Path data (absolute M, L, Q, C and z) in relative form with two decimals; rounding errors do not accumulate."""
    here = start = (0, 0)
    commands: list[tuple[str, list[int]]] = []
    for command, numbers in re.findall(r"([MLQCz])([^A-Za-z]*)", path):
        values = [round(100 * float(value)) for value in numbers.split()]
        points = list(zip(values[::2], values[1::2], strict=True))
        if command == "M":
            commands.append(("M", values))
            start = points[0]
        elif command != "z":
            moved = [value for x, y in points for value in (x - here[0], y - here[1])]
            if commands[-1][0] == command.lower():
                commands[-1][1].extend(moved)
            else:
                commands.append((command.lower(), moved))
        else:
            commands.append(("z", []))
        here = start if command in "Mz" else points[-1]
    return "".join(command + _joined(values) for command, values in commands)


def _joined(values: list[int]) -> str:
    """Hundredths as numbers, with spaces only where needed to separate them."""
    texts = [_number(value) for value in values]
    return "".join(text if i == 0 or text[0] == "-" else " " + text for i, text in enumerate(texts))


def _number(hundredths: int) -> str:
    """`1.5` for 150."""
    return f"{hundredths / 100:.2f}".rstrip("0").rstrip(".") if hundredths else "0"


def marked(text: str) -> str:
    """Escaped text with symbols in italics and subscripts lowered, as tspans."""
    tags = {
        "symbol": ('<tspan font-style="italic">', "</tspan>"),
        "sub": ('<tspan dy="0.22em" font-size="75%">', '</tspan><tspan dy="-0.165em">\u200b</tspan>'),
        "text": ("", ""),
    }
    return "".join(part.join(tags[kind]) for kind, part in symbol_parts(text))
