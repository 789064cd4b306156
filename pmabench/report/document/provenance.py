"""What runs record about themselves, as text for a page.

Specimen, bench, protocol, hashes, calibrations. Manifests are untrusted and everything in them is optional; nothing
here raises for what is missing or odd.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.plotting.wording import POINTS, Frame, clean, in_order, number, point_shown, shown
from pmabench.report.words import kind_title
from pmabench.store.folder import is_regular, sha256_of
from pmabench.store.records import RunData, is_number

LISTED = 8
"""Values of a swept coordinate that are listed; of more, the ends and the count are."""
UNNAMED = "muscle of unknown type"
"""A specimen whose record has no type, or says `unknown`, as maps of old files do."""
LONGEST_SEAL = 10_000_000
SPECIMEN = {"nominal_length": "length", "inner_diameter": "length", "braid_angle": "angle", "mass": "mass"}


def text_of(value: Any, longest: int = 300) -> str:
    """Whatever a manifest holds, as one line of text."""
    if value is None:
        return ""
    if isinstance(value, Mapping):
        return "; ".join(f"{clean(k, 60)} {text_of(v)}".strip() for k, v in value.items() if v not in (None, "", {}))
    if isinstance(value, list | tuple):
        return ", ".join(text_of(item) for item in value)
    if isinstance(value, float):
        return number(value)
    return clean(value, longest)


def get(data: Any, *names: str) -> Any:
    """A nested entry, or None."""
    for name in names:
        data = data.get(name) if isinstance(data, Mapping) else None
    return data


def _name_of(entry: Any) -> str:
    """The name in an entry, else the entry itself."""
    return text_of((entry.get("name") if isinstance(entry, Mapping) else None) or entry)


def specimens(runs: Sequence[RunData]) -> list[tuple[str, str]]:
    """Name and description of every specimen."""
    found: dict[str, str] = {}
    for run in runs:
        specimen = run.manifest.get("specimen")
        if isinstance(specimen, Mapping):
            make, kind, serial = (text_of(specimen.get(key)) for key in ("make", "type", "serial"))
            named = [text for text in (make, kind) if text and text.casefold() != "unknown"]
            serial = "" if serial.casefold() == "unknown" else serial
            name = " ".join(named) + f", serial {serial}" * bool(serial and named)
            found.setdefault(name or serial or UNNAMED, _specimen(specimen))
        elif specimen:
            found.setdefault(text_of(specimen), "")
    return list(found.items())


def _specimen(specimen: Mapping[str, Any]) -> str:
    lines = []
    for key, quantity in SPECIMEN.items():
        value, unit = specimen.get(key), shown(quantity)
        if is_number(value):
            lines.append(f"{key.replace('_', ' ')} {number(value / unit.scale)} {unit.unit}")
    length = get(specimen, "mounted", "length")
    if isinstance(length, int | float):
        at = text_of(get(specimen, "mounted", "at"))
        lines.append(f"mounted at {number(length / shown('length').scale)} mm" + (f" ({at})" if at else ""))
    if isinstance(specimen.get("cycles_before"), int | float):
        lines.append(f"{number(specimen['cycles_before'])} cycles before these runs")
    return ", ".join(lines)


def benches(runs: Sequence[RunData]) -> list[tuple[str, str]]:
    """Name of every bench, and its devices."""
    found: dict[str, str] = {}
    for run in runs:
        devices, lines = run.manifest.get("devices"), []
        for device_name, device in devices.items() if isinstance(devices, Mapping) else ():
            if isinstance(device, Mapping):
                parts = [text_of(device.get(key), 60) for key in ("maker", "model")]
                parts += [f"{key} {text_of(device[key], 60)}" for key in ("serial", "firmware") if device.get(key)]
                tried = text_of(get(run.manifest, "drivers", device_name, "verified"), 120)
                if tried and not device.get("simulated"):
                    parts.append(f"(driver verified: {tried})")
                lines.append(" ".join(part for part in parts if part))
        found.setdefault(_name_of(run.manifest.get("bench")), "; ".join(lines))
    return [(name, about) for name, about in found.items() if name]


def when(runs: Sequence[RunData]) -> str:
    """First and last day of the runs, UTC."""
    days = sorted({text_of(run.manifest.get("started_utc"), 40)[:10] for run in runs} - {""})
    return " to ".join(dict.fromkeys((days[0], days[-1]))) if days else ""


def operators(runs: Sequence[RunData]) -> str:
    """Everyone who was at the bench."""
    return ", ".join(dict.fromkeys(text_of(who) for run in runs if (who := run.manifest.get("operator"))))


def statuses(runs: Sequence[RunData]) -> str:
    """How the runs ended, in a phrase."""
    counts = Counter(clean(run.status, 40) for run in runs)
    ended = ", ".join(f"{count} {status}" for status, count in counts.items())
    return f"{len(runs)} run{'s' if len(runs) != 1 else ''}: {ended}" if runs else "the runs are not at hand"


def protocol_table(runs: Sequence[RunData], names: Mapping[str, str]) -> Frame:
    """One row a run: what was tested, where, for how long; `names` are the short names of runs."""
    rows = []
    for run in runs:
        planned, source = run.manifest.get("trials_planned"), text_of(run.manifest.get("source"))
        done = sum(trial.status == "finished" and not trial.again for trial in run.trials)
        rows.append(
            {
                "run": names.get(run.id, ""),
                "test": kind_title(run.kind),
                "protocol": _name_of(run.manifest.get("protocol")) + (f" (after: {source})" if source else ""),
                "operating points": _points(run),
                "trials": f"{done} of {planned}" if isinstance(planned, int) else str(done),
                "rate": f"{run.rate:.4g} Hz" if run.rate else "",
                "duration": _duration(run.manifest.get("duration")),
                "status": clean(run.status, 40),
            }
        )
    return Frame(rows)


def _duration(value: Any) -> str:
    return "" if not is_number(value) else f"{value / 60:.0f} min" if value >= 120 else f"{value:.0f} s"


def _points(run: RunData) -> str:
    ranges = []
    points = [trial.point for trial in run.trials]
    for name in in_order((key for point in points for key in point if key not in ("mass", "cycles")), POINTS):
        label, unit = point_shown(name)
        values = sorted({round(point[name] / unit.scale, 6) for point in points if name in point})
        listed = ", ".join(number(value) for value in values)
        if len(values) > LISTED:
            listed = f"{number(values[0])} to {number(values[-1])} ({len(values)} values)"
        ranges.append(f"{label} = {listed} {unit.unit}".rstrip())
    repeats = {trial.repeat for trial in run.trials}
    return "; ".join(ranges) + (f"; {len(repeats)} repeats" if len(repeats) > 1 else "")


def run_table(runs: Sequence[RunData], names: Mapping[str, str]) -> Frame:
    """Identity of every run: id, when, and the hashes that show whether it was changed."""
    rows = []
    for run in runs:
        row = {
            "run": names.get(run.id, ""),
            "id": clean(run.id, 200),
            "started (UTC)": text_of(run.manifest.get("started_utc"), 40)[:19].replace("T", " "),
            "closed (UTC)": text_of(run.manifest.get("closed_utc"), 40)[:19].replace("T", " "),
            "status": clean(run.status, 40),
            "sha256 of plan.json": text_of(run.manifest.get("plan_sha256"), 64),
            "sha256 of seal.json": _seal(run),
        }
        imported = run.manifest.get("imported")
        if isinstance(imported, Mapping):
            row["imported file"] = text_of(imported.get("file"), 120)
            row["sha256 of that file"] = text_of(imported.get("sha256"), 64)
        rows.append(row)
    return Frame(rows)


def _seal(run: RunData) -> str:
    path = Path(run.path) / "seal.json"
    with suppress(OSError, ValueError):
        if run.path and is_regular(path) and path.stat().st_size < LONGEST_SEAL:
            return sha256_of(path)
    return ""


def versions(runs: Sequence[RunData]) -> list[str]:
    """The programs that recorded the runs, each combination once."""
    return list(dict.fromkeys(text_of(run.manifest.get("versions")) for run in runs if run.manifest.get("versions")))


def calibration_table(
    runs: Sequence[RunData], names: Mapping[str, str], reduced: Mapping[tuple[str, str], str]
) -> Frame:
    """Channel, calibration that it was recorded with and its expanded uncertainty, with the runs that used it.

    `reduced` says by run and channel what was taken in its place, where that is another.
    """
    rows: dict[tuple[str, ...], list[str]] = {}
    for run in runs:
        for info in run.channels.values():
            unit = shown(info.quantity, info.unit)
            offset = f"{info.offset_uncertainty / unit.scale:.3g} {unit.unit}" if info.offset_uncertainty else ""
            gain = f"{info.gain_uncertainty:.2%}" if info.gain_uncertainty else ""
            lag = f"{info.sensor_lag * 1e3:.3g} ms" if info.sensor_lag else ""
            other = reduced.get((run.id, info.name), "")
            key = (clean(info.name, 60), clean(info.calibration, 80) or "none", offset, gain, lag, other)
            rows.setdefault(key, []).append(names.get(run.id, "?"))
    recorded = "recorded with" if reduced else "calibration"
    heads = ("channel", recorded, "offset, 95 %", "gain, 95 %", "sensor lag", "reduced here with")
    frame = Frame([{**dict(zip(heads, key, strict=True)), "runs": ", ".join(who)} for key, who in rows.items()])
    return frame.filled() if len(frame) else frame


def span(name: str, values: Sequence[float], sign: str) -> str:
    """The range of a coordinate of operating points in words, with its label and a sign: `P = 100 to 500 kPa`."""
    label, unit = point_shown(name)
    low, high = (number(float(f"{end / unit.scale:.4g}")) for end in (min(values), max(values)))
    return f"{label}{sign}{low if low == high else f'{low} to {high}'} {unit.unit}".rstrip()
