"""Words and numbers of the display: safe text from devices and files, times, values in display units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from math import ceil, isfinite, log10
from typing import Any

from rich.cells import cell_len

from pmabench.base.quantities import CHANNEL_QUANTITY, QUANTITIES, Quantity, in_words
from pmabench.base.text import printable
from pmabench.store.analyses.results import POINT_QUANTITIES
from pmabench.store.records import Event

LONGEST = 400
"""Longest text in characters."""
POINT = {
    "load": "F_L", "pressure": "P", "from": "P_1", "frequency": "f", "setpoint": "x", "contraction": "x",
    "speed": "v", "lower": "x_1", "upper": "x_2", "start": "x_0", "step": "dx", "mean": "x_0", "amplitude": "A",
    "bias": "P_0", "mass": "M", "tip_mass": "w", "pressure_1": "P_1", "pressure_2": "P_2", "angular_speed": "ω",
    "lowest_angle": "θ_1", "highest_angle": "θ_2", "goal": "θ", "integral": "K_i", "phi": "φ", "psi": "ψ",
}  # fmt: skip
"""Coordinate of an operating point -> symbol; only these are shown with a unit."""


def clean(text: object) -> str:
    """A text on one line without control characters."""
    return printable(" ".join(str(text)[: 4 * LONGEST].split()), LONGEST)


def quantity(name: str) -> Quantity:
    """Quantity of this name; one without a unit if it is unknown."""
    return QUANTITIES.get(name, Quantity(name, "", "", 1.0))


def of_point(name: str) -> tuple[str, Quantity]:
    """Symbol and quantity of a coordinate of an operating point."""
    return POINT.get(name, clean(name)), quantity(POINT_QUANTITIES[name] if name in POINT else "")


def clock(seconds: float) -> str:
    """`m:ss`, or `h:mm:ss` from an hour on."""
    whole = max(0, int(seconds))
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"


def decimals(span: float) -> int:
    """Number of decimals for values up to `span` [display unit]: four digits in total."""
    if not isfinite(span) or span <= 0:
        return 2
    return min(3, max(0, 4 - max(1, ceil(log10(span) + 1e-9))))


def value_text(value: float | None, name: str, span: float) -> str:
    """A value [SI] of the named quantity, with decimals according to `span` [SI]."""
    if value is None or not isfinite(value):
        return "-"
    q = quantity(name)
    text = f"{value / q.scale:.{decimals(abs(span) / q.scale)}f}"
    return text.lstrip("-") if not text.strip("-0.") else text


def point_text(point: Mapping[str, float]) -> str:
    """An operating point in words; the moving mass is left out if the load is given."""
    shown = {name: value for name, value in point.items() if not (name == "mass" and "load" in point)}
    texts = (of_point(name)[1].show(value, 4) if name in POINT else f"{value:.4g}" for name, value in shown.items())
    return ", ".join(f"{clean(name)} {text}" for name, text in zip(shown, texts, strict=True))


def about_run(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Kind, time, day (`session`) and campaign of a run."""
    campaign, started = manifest.get("campaign"), clean(manifest.get("started_utc", ""))
    name = clean(campaign.get("name", "")) if isinstance(campaign, dict) else ""
    return {"kind": clean(manifest.get("kind", "")), "started": started, "session": started[:10], "campaign": name}


_ELSEWHERE = ("command", "acknowledged", "clock", "found", "trial-begin", "trial-end", "key", "live")
"""Events that are not shown in the log, but elsewhere."""
_IN_LOG = {
    "armed": ("armed: ", "bench", "info"),
    "prompt": ("asked: ", "text", "info"),
    "answer": ("answered: ", "answer", "info"),
    "limit-reached": ("limit reached: ", "reason", "doubt"),
    "warning": ("warning: ", "reason", "doubt"),
    "trip": ("TRIPPED: ", "reason", "fault"),
    "ended-early": ("ended early: ", "reason", "fault"),
    "note": ("note: ", "text", "info"),
    "plan-change": ("next: ", "why", "info"),
    "choice-end": ("no further trial: ", "why", "info"),
    "pause": ("paused at low pressure", "", "info"),
    "goes-on": ("goes on", "", "info"),
    "controlled-stop": ("controlled stop", "", "info"),
}
"""Kind of event -> words, the entry of its data that follows them, and the level."""


def event_text(event: Event) -> tuple[str, str] | None:
    """An event as a sentence, and its level: `info`, `doubt`, `fault`; None if it is shown elsewhere."""
    data, kind = event.data, event.kind
    if kind in _ELSEWHERE:
        return None
    if kind == "warning" and data.get("action") in ("hold", "over"):
        held = data["action"] == "hold"
        reason = clean(str(data.get("reason", "")))
        return ("held, nothing new is commanded: " if held else "") + reason, "doubt" if held else "info"
    if kind in _IN_LOG:
        words, entry, level = _IN_LOG[kind]
        lines = str(data.get(entry, "")).strip().splitlines() if entry else []
        return words + clean(lines[-1] if lines else ""), level  # the last line of a traceback is the error
    if kind == "load":
        force, mass = data.get("force"), data.get("mass")
        text = f"load {quantity('force').show(float(force), 4)}" if isinstance(force, int | float) else "load"
        return text + (f", {float(mass):.4g} kg moving" if isinstance(mass, int | float) else ""), "info"
    if kind in OF_SESSIONS:
        return OF_SESSIONS[kind](data)
    if kind == "proof-test":
        asked, filled, vented = (float(data.get(key) or 0.0) for key in ("pressure", "filled_in", "vented_in"))
        alone = data.get("dump_valve_in")
        valve = f"gives way to the dump valve in {alone:.2g} s, " if isinstance(alone, int | float) else ""
        empty = f"{valve}empty {vented:.2g} s after venting"
        full = f"filled to {quantity('pressure').show(asked, 4)} in {filled:.2g} s"
        return f"proof test of the vent path: {full}, {empty}", "info"
    if kind == "vent":
        result = clean(data.get("result", ""))
        return f"vent {result}", "info" if result == "confirmed" else "fault"
    if kind == "end":
        why, status = clean(data.get("why", "")), clean(data.get("status", ""))
        return f"{status}{f': {why}' if why else ''}", "info" if status == "finished" else "fault"
    level = "doubt" if data.get("ok") is False or "warn" in kind or "lost" in kind else "info"
    said = (f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in data.items())
    text = data.get("text") or data.get("reason") or ", ".join(said)
    return clean(f"{kind}: {text}" if text else kind), level


def _session(data: Mapping[str, Any]) -> tuple[str, str]:
    less = [f"{what} skipped because {why}" for what, why in (data.get("skipped") or {}).items()]
    less += data.get("shortened") or []
    return clean(f"session{': ' if less else ''}{'; '.join(map(str, less))}"), "doubt" if less else "info"


def _self_test(data: Mapping[str, Any]) -> tuple[str, str]:
    """Number of checks by verdict, and the failed ones in full."""
    checks = [check for check in data.get("checks") or [] if isinstance(check, dict)]
    counts = Counter(str(check.get("verdict")) for check in checks)
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    wrong = [check for check in checks if check.get("verdict") not in ("ok", "not measured", "not checked")]
    verdicts += "".join(f"; {check.get('name')}: {check.get('value')}, {check.get('hint')}" for check in wrong)
    return clean(f"self-test: {verdicts}"), "fault" if wrong else "info"


def _zeros(data: Mapping[str, Any]) -> tuple[str, str]:
    return clean(f"zeros taken: {_by_channel(data, 'value')}"), "info"


def _zero_check(data: Mapping[str, Any]) -> tuple[str, str]:
    wrong = any(zero.get("ok") is False for zero in (data.get("channels") or {}).values())
    return clean(f"zeros have drifted by {_by_channel(data, 'drift')}"), "doubt" if wrong else "info"


def _by_channel(data: Mapping[str, Any], entry: str) -> str:
    """One number of each channel, as text."""
    zeros = []
    for name, zero in (data.get("channels") or {}).items():
        if isinstance(zero.get(entry), int | float):
            q = quantity(CHANNEL_QUANTITY.get(str(name), ""))
            zeros.append(f"{name} {q.show(float(zero[entry]), 3)}")
    return ", ".join(zeros) or "nothing that was measured"


def _warm_up(data: Mapping[str, Any]) -> tuple[str, str]:
    pressure = quantity("pressure").show(float(data.get("pressure") or 0.0), 4)
    return f"warm-up: cycles to {pressure} for {in_words(float(data.get('duration') or 0.0))}", "info"


OF_SESSIONS: dict[str, Callable[[Mapping[str, Any]], tuple[str, str]]] = {
    "session": _session,
    "self-test": _self_test,
    "zeros": _zeros,
    "zero-check": _zero_check,
    "warm-up": _warm_up,
}
"""Kind of event of a session -> its sentence, and how bad it is."""


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
