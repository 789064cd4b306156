"""State of a run as plain data for the page: texts, and numbers in display units.

Each function returns one part of the page, which is sent again only when it has changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from pmabench.analysis.trial import Expected
from pmabench.base.errors import InvalidFile
from pmabench.display.channel import Channel
from pmabench.display.lines import against_text, half_text, number_text, off_text, point_columns
from pmabench.display.state import RunState
from pmabench.display.verdicts import Number, TrialLine
from pmabench.display.view import WANTED
from pmabench.display.web.series import axes_of
from pmabench.display.wording import POINT, about_run, clean, decimals, of_point, point_text, quantity
from pmabench.files.document import Document
from pmabench.kinds import registry

NOTICES = 60
"""Number of notices sent."""
SYMBOLS = {"pressure": "P", "displacement": "x", "force": "F", "angle": "angle", "supply": "supply"}
FINISHED = ("finished", "failed")
"""Status of a run that `process` accepts as it is."""


def _shown(value: float | None, scale: float, digits: int) -> float | None:
    """A value [SI] in its display unit, rounded; None if missing."""
    return None if value is None or not isfinite(value) else round(value / scale, digits)


def digits_of(channel: Channel) -> int:
    """Decimals of a channel's values in its display unit."""
    return decimals(channel.span / quantity(channel.quantity).scale)


def run_part(state: RunState, root: Path, *, vent: bool) -> dict[str, Any]:
    """Identity of the run, how it ended, the next command, and whether there is a vent button."""
    manifest = state.files.manifest
    status, folder = state.status, state.files.folder
    return {
        "id": folder.name if state.files.there else "",
        "there": state.files.there,
        "problem": clean(state.files.problem or ("" if state.files.there else f"waiting for a run in {root}")),
        **about_run(manifest),
        "simulated": state.simulated,
        "specimen": clean(state.specimen),
        "bench": clean(state.files.bench.get("name", "")),
        "operator": clean(manifest.get("operator", "")),
        "status": clean(status),
        "why": clean(state.why) if status not in {"running", "waiting"} else "",
        "vent": clean(state.vent),
        "ended": state.ended,
        "next": _next(state) if state.ended else "",
        "may_vent": vent,
        "axes": axes_of(state),
    }


def _next(state: RunState) -> str:
    """The next command after the end of a run."""
    place = state.files.folder
    if not state.trials:
        return ""
    return f"pmabench process {place}" if state.status in FINISHED else f"pmabench continue {place}"


def may_vent(folder: Path) -> bool:
    """Whether the bench file of the run in `folder` itself, not one that it includes, allows the vent button."""
    path = folder / "bench.yaml"
    try:
        return Document(str(path), path.read_text("utf-8-sig")).data.get("web_vent") is True
    except (InvalidFile, OSError, ValueError):
        return False


def now_part(state: RunState) -> dict[str, Any]:
    """Position of the run: trial, phase, time; question to the operator; present commands."""
    trial, running = state.trial, state.status == "running"
    left = state.progress.left(state.t) if state.progress is not None and running else None
    if trial is not None:
        which = "reference trial again" if trial.again else f"trial {trial.index + 1} of {state.trials}"
    elif not state.trials:
        which = "by hand" if running else ""
    else:
        which = f"{state.done} of {state.trials} trials done"
    doing = clean(state.phase) if running else ""
    if running and state.paused:
        doing = "paused"
    elif running and state.held:
        doing = f"held by {clean(', '.join(sorted(state.held)))}: nothing new is commanded"
    elif running and trial is None:
        doing = "nothing is recorded"
    wanted = [words for key, words in WANTED if key in state.wanted] if running else []
    settings = [f"{clean(s.output)} {quantity(s.quantity).show(s.value, 4)}" for s in state.settings.values()]
    counts = {name: count for name, count in state.counts.items() if count}
    return {
        "trial": which,
        "number": trial.index + 1 if trial is not None and not trial.again else state.done,
        "of": state.trials,
        "point": point_text(trial.point) if trial is not None else "",
        "repeat": trial.repeat + 1 if trial is not None and trial.repeat else 0,
        "recording": trial is not None and running,
        "doing": ", ".join([doing, *wanted]) if wanted else doing,
        "asked": clean(state.prompt) if running else "",
        "elapsed": int(state.t),
        "left": None if left is None else int(left),
        "paused": state.paused or bool(state.prompt),
        "done": round(state.progress.done(state.t), 3) if state.progress is not None else 0.0,
        "commanded": settings,
        "rows": state.rows // 1000 * 1000 if running else state.rows,
        "rate": max((stream.rate for stream in state.files.streams.values()), default=0.0),
        "flagged": counts,
    }


def channels_part(state: RunState) -> list[dict[str, Any]]:
    """Channels with their limits and the ends of their bars."""
    parts = []
    for channel in state.channels.values():
        q, digits = quantity(channel.quantity), digits_of(channel)
        low, high = channel.axis()
        parts.append(
            {
                "name": channel.name,
                "label": clean(channel.name).replace("_command", " set").replace("_", " "),
                "symbol": SYMBOLS.get(channel.name, ""),
                "stream": channel.stream,
                "unit": q.shown_in,
                "digits": digits,
                "scale": q.scale,
                "axis": [_shown(low, q.scale, digits + 1), _shown(high, q.scale, digits + 1)],
                "trip": [_shown(v, q.scale, digits + 1) for v in (channel.trip_low, channel.trip_high)],
                "command": [_shown(v, q.scale, digits + 1) for v in (channel.command_low, channel.command_high)],
                "rate": getattr(state.files.streams.get(channel.stream), "rate", 0.0),
            }
        )
    return parts


def values_of(state: RunState) -> dict[str, list[Any]]:
    """Newest value, minimum, maximum, age [s] and alarm (0, 1, 2) of each channel."""
    found = {}
    for channel in state.channels.values():
        scale, digits = quantity(channel.quantity).scale, digits_of(channel)
        values = [_shown(v, scale, digits) for v in (channel.value, channel.least, channel.most)]
        age = None if channel.age is None else round(min(channel.age, 1e6), 1)
        found[channel.name] = [*values, age, channel.alarm]
    return found


def _heading(name: str) -> dict[str, str]:
    symbol, q = of_point(name)
    return {"symbol": symbol, "unit": q.shown_in}


def trials_part(state: RunState) -> dict[str, Any]:
    """The table of finished trials."""
    lines = state.lines
    if not lines:
        return {"point": [], "numbers": [], "rows": []}
    names = point_columns(lines)
    longest = max((line.numbers for line in lines), key=len)
    rows = [
        {
            "ok": line.ok,
            "mark": {"ok": "✓", "? ": "!"}.get(line.mark, "–"),
            "trial": line.number,
            "again": line.again,
            "status": clean(line.status),
            "point": [
                "–" if (v := line.point.get(name)) is None else f"{v / of_point(name)[1].scale:.4g}" for name in names
            ],
            "numbers": [_both(n) for n in line.numbers],
            "doubts": [clean(doubt) for doubt in line.doubts],
        }
        for line in lines
    ]
    return {
        "point": [_heading(name) for name in names],
        "numbers": [{"symbol": n.symbol, "unit": quantity(n.quantity).shown_in} for n in longest],
        "rows": rows,
        "against": against_text(lines),
        "assumed": any(n.assumed for line in lines for n in line.numbers),
    }


def _both(number: Number) -> list[str]:
    """A value, and its interval or its deviation from the reference."""
    return [number_text(number).replace("-", "−"), half_text(number) or off_text(number).replace("-", "−")]


def coefficients_part(state: RunState, expected: Expected | None) -> list[dict[str, Any]]:
    """Measured quantities over the varied coordinate: one curve for each quantity, K and the headlines first."""
    along = _along(state)
    planned = [p for trial in state.files.plan.get("trials") or () if (p := _place(trial.get("point"), along))]
    axis = _heading(along) if along else {"symbol": "trial", "unit": ""}
    kind = registry.find(state.kind)
    order = [result.symbol for result in kind.results if result.headline] if kind else []
    numbers = {n.symbol: n.quantity for line in state.lines for n in line.numbers}
    expected = expected if along == "pressure" else None
    if expected is not None and not numbers:
        numbers = {symbol: of for symbol, of in (("K", "stiffness"),) if symbol in order}
    curves = []
    order = ["K", *order]
    for symbol, of in sorted(numbers.items(), key=lambda item: order.index(item[0]) if item[0] in order else 99):
        scale = quantity(of).scale
        curve: dict[str, Any] = {"symbol": symbol, "unit": quantity(of).shown_in, "axis": axis}
        curve["points"] = _points(state, symbol, along)
        curve["range"] = [min(planned), max(planned)] if planned else None
        curve["expected"] = _references(state, symbol, along)
        if symbol == "K" and expected is not None:
            curve["expected"] = [
                [round(P / 1e3, 3), _round(K / scale)]
                for P, K in zip(expected.pressure.tolist(), expected.K.tolist(), strict=True)
            ]
        curves.append(curve)
    return curves


def _along(state: RunState) -> str:
    """The varied coordinate: pressure if possible, else the first other; empty: trials by number."""
    points = [trial.get("point") or {} for trial in state.files.plan.get("trials") or () if isinstance(trial, dict)]
    names = list(dict.fromkeys(name for point in points for name in point if name in POINT))
    varied = [name for name in names if len({point.get(name) for point in points}) > 1 and name not in {"mass"}]
    return "pressure" if "pressure" in varied else next(iter(varied), "")


def _place(point: Any, along: str) -> float | None:
    value = point.get(along) if isinstance(point, Mapping) else None
    return round(value / of_point(along)[1].scale, 6) if isinstance(value, int | float) else None


def _round(value: float) -> float:
    return float(f"{value:.5g}")


def _measured(state: RunState, symbol: str, along: str) -> Iterator[tuple[float, TrialLine, Number]]:
    """Place on the axis, trial and number, for each number of a quantity; over trial numbers if `along` is empty."""
    for line in state.lines:
        place = _place(line.point, along) if along else float(line.number)
        if place is not None:
            yield from ((place, line, number) for number in line.numbers if number.symbol == symbol)


def _points(state: RunState, symbol: str, along: str) -> list[list[Any]]:
    """[place, value, trial number, whether without doubt, half width or None] for each measured value."""
    found = []
    for place, line, n in _measured(state, symbol, along):
        if n.value is not None and isfinite(n.value):
            scale = quantity(n.quantity).scale
            half = None if n.half is None or not isfinite(n.half) else _round(n.half / scale)
            found.append([place, _round(n.value / scale), line.number, line.ok, half])
    return found


def _references(state: RunState, symbol: str, along: str) -> list[list[float]]:
    """Mean prediction of the specimen file at each place with trials."""
    found: dict[float, list[float]] = {}
    for place, _line, n in _measured(state, symbol, along):
        if n.reference_is == "expected" and n.reference is not None:
            found.setdefault(place, []).append(n.reference / quantity(n.quantity).scale)
    return [[place, _round(sum(values) / len(values))] for place, values in sorted(found.items())]


def log_part(state: RunState) -> list[list[Any]]:
    """The newest sentences of the log: time [s], text, level."""
    last = list(state.notices)[-NOTICES:]
    return [[None if n.t is None else round(n.t, 2), clean(n.text), n.level] for n in last]
