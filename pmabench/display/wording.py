"""Words and numbers of the display: device and file text made harmless, times, values in people's units."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from math import ceil, isfinite, log10

from rich.cells import cell_len

from pmabench.base.quantities import QUANTITIES, Quantity
from pmabench.store.records import Event

LONGEST = 400
"""Characters of a text that are kept."""
POINT = {
    "load": ("F_L", "force"),
    "pressure": ("P", "pressure"),
    "frequency": ("f", "frequency"),
    "setpoint": ("x", "length"),
    "mean": ("x_0", "length"),
    "amplitude": ("A", "length"),
    "bias": ("P_0", "pressure"),
    "mass": ("M", "mass"),
}
"""Names of an operating point -> symbol and quantity."""
_HIDDEN = ("mass",)


def clean(text: object) -> str:
    """A text on one line without anything that a terminal could obey."""
    told = " ".join(str(text)[: 4 * LONGEST].split())
    told = "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c)[0] == "C" else c for c in told)
    return told if len(told) <= LONGEST else told[: LONGEST - 1] + "…"


def quantity(name: str) -> Quantity:
    """The quantity of this name; one without a unit where it is not known."""
    return QUANTITIES.get(name, Quantity(name, "", "", 1.0))


def clock(seconds: float) -> str:
    """`m:ss`, or `h:mm:ss` from an hour on."""
    whole = max(0, int(seconds))
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"


def decimals(span: float) -> int:
    """How many decimals a value needs whose largest size is `span` [display unit]: four digits in all."""
    if not isfinite(span) or span <= 0:
        return 2
    return min(3, max(0, 4 - max(1, ceil(log10(span) + 1e-9))))


def value_text(value: float | None, name: str, span: float) -> str:
    """A value [SI] of the named quantity, with as many decimals as `span` [SI] needs."""
    if value is None or not isfinite(value):
        return "-"
    q = quantity(name)
    text = f"{value / q.scale:.{decimals(abs(span) / q.scale)}f}"
    return text.lstrip("-") if not text.strip("-0.") else text


def point_text(point: Mapping[str, float]) -> str:
    """An operating point in words; the moving mass is left out where the load is told."""
    shown = []
    for name, value in point.items():
        if name in _HIDDEN and "load" in point:
            continue
        told = quantity(POINT[name][1]).show(value, 4) if name in POINT else f"{value:.4g}"
        shown.append(f"{clean(name)} {told}")
    return ", ".join(shown)


def event_text(event: Event) -> tuple[str, str] | None:
    """An event as a sentence, and how bad it is: `info`, `doubt`, `fault`; None for what is shown elsewhere."""
    data, kind = event.data, event.kind
    if kind in ("command", "clock", "found", "trial-begin", "trial-end", "start", "heartbeat"):
        return None
    if kind == "armed":
        return f"armed: {clean(data.get('bench', ''))}", "info"
    if kind == "prompt":
        return f"asked: {clean(data.get('text', ''))}", "info"
    if kind == "answer":
        return f"answered: {clean(data.get('answer', ''))}", "info"
    if kind == "load":
        force, mass = data.get("force"), data.get("mass")
        told = f"load {quantity('force').show(float(force), 4)}" if isinstance(force, int | float) else "load"
        return told + (f", {float(mass):.4g} kg moving" if isinstance(mass, int | float) else ""), "info"
    if kind == "limit-reached":
        return f"limit reached: {clean(data.get('reason', ''))}", "doubt"
    if kind == "trip":
        return f"TRIPPED: {clean(data.get('reason', ''))}", "fault"
    if kind == "ended-early":
        lines = str(data.get("reason", "")).strip().splitlines()
        return f"ended early: {clean(lines[-1] if lines else '')}", "fault"
    if kind == "vent":
        result = clean(data.get("result", ""))
        return f"vent {result}", "info" if result == "confirmed" else "fault"
    if kind == "note":
        return f"note: {clean(data.get('text', ''))}", "info"
    if kind == "end":
        why = clean(data.get("why", ""))
        status = clean(data.get("status", ""))
        return f"{status}{f': {why}' if why else ''}", "info" if status == "finished" else "fault"
    told = ", ".join(f"{clean(key)} {clean(value)}" for key, value in data.items())
    return clean(f"{kind}: {told}" if told else kind), "doubt" if "warn" in kind or "lost" in kind else "info"


def wrapped(text: str, width: int) -> list[str]:
    """A text in lines of at most `width` columns, broken between words."""
    lines, line = [], ""
    for word in text.split(" "):
        if line and cell_len(line) + 1 + cell_len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}" if line else word
    return [*lines, line]
