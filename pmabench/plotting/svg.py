"""Parts of SVG: symbols (`F_ce`) as text in italics with subscripts, paths in few letters, an element as a file."""

from __future__ import annotations

import re

SYMBOL = re.compile(
    r"(?<![\w-])(?P<base>[A-Za-z]|OS|tau|phi|psi|eta|eps|omega|theta|alpha)(?:_(?P<sub>[A-Za-z]{1,4}|\d))?(?![\w'’-])"
)
"""A symbol; without a subscript it counts only before a unit or an equals sign, or alone, unless it is Greek."""
UNITS = {"N", "s", "J", "V", "A", "m"}
"""Letters that are a unit, not a symbol, when they are alone."""
GREEK = {"tau": "τ", "phi": "φ", "psi": "ψ", "eta": "η", "eps": "ε", "omega": "ω", "theta": "θ", "alpha": "α"}


PSI = re.compile(r"(?:^|(?<=, ))psi (?=\[|=|[-−]?\d)|^psi$")
"""The angle psi; elsewhere it is a unit of pressure."""


def symbol_parts(text: str) -> list[tuple[str, str]]:
    """Split into (`text`, ...), (`symbol`, ...) and (`sub`, ...) pieces: `F_ce [N]` -> symbol F, sub ce, text."""
    pieces: list[tuple[str, str]] = []
    end = 0
    for found in SYMBOL.finditer(text):
        base, sub = found["base"], found["sub"]
        rest = text[found.end() :]
        whole = found.start() == 0 and (rest.startswith(", ") or (rest[:1] in ("", "/") and base not in UNITS))
        lone = whole or rest.startswith((" [", " = ", " over ")) or re.match(r" and [a-z]", rest)
        if sub is None and base not in GREEK and not lone:
            continue
        if base == "psi" and not PSI.match(text, found.start()):
            continue
        pieces += [("text", text[end : found.start()]), ("symbol", GREEK.get(base, base))]
        if sub:
            pieces.append(("sub", sub))
        end = found.end()
    pieces.append(("text", text[end:]))
    return [(kind, part) for kind, part in pieces if part]


def capital(text: str) -> str:
    """The text with a capital, unless a symbol begins it: `tau_F at 350 kPa`."""
    found = SYMBOL.match(text)
    return text if found and (found["sub"] or found["base"] in GREEK) else f"{text[:1].upper()}{text[1:]}"


def as_file(svg: str, font: str) -> str:
    """The SVG element as a separate file: sizes in points (1/72 in), text in `font`, on white."""
    box = re.search(r'viewBox="\S+ \S+ (\S+) ([^" ]+)"', svg)
    size = f'width="{box[1]}pt" height="{box[2]}pt" ' if box else ""
    look = f'font-family="{font}" style="background: #fff"'
    return svg.replace("<svg ", f'<svg xmlns="http://www.w3.org/2000/svg" {size}{look} ', 1)


def shortened(path: str) -> str:
    """Path data (absolute M, L and z) in relative form with two decimals; rounding errors do not accumulate."""
    here = start = (0, 0)
    commands: list[tuple[str, list[int]]] = []
    for command, numbers in re.findall(r"([MLz])([^A-Za-z]*)", path):
        values = [round(100 * float(value)) for value in numbers.split()]
        if command == "L":
            x, y = values
            moved = [x - here[0], y - here[1]]
            if commands[-1][0] == "l":
                commands[-1][1].extend(moved)
            else:
                commands.append(("l", moved))
            here = x, y
        else:
            commands.append((command, values))
            if command == "M":
                start = values[0], values[1]
            here = start
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
