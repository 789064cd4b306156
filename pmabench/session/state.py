"""The session that is kept for a bench, and why it is no longer valid; commands nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any

from pmabench.base.quantities import in_words
from pmabench.bench.compile import Mounted
from pmabench.guard.station import Station

FILE = "session"


def kept(bench: str) -> dict[str, Any]:
    """What is kept of the last session of a bench; empty where there is none."""
    return Station(bench).read(FILE)


def keep(bench: str, session: Mapping[str, Any]) -> None:
    """Keep a session."""
    station = Station(bench)
    station.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    station.write(FILE, session)


def calibrations(mounted: Mounted) -> dict[str, dict[str, Any]]:
    """Which calibration each channel had, before any zero."""
    return {
        channel.name: {
            "id": channel.calibration.id,
            "sha256": channel.calibration.sha256,
            "slope": channel.scale.slope,
            "offset": channel.calibrated.offset,
        }
        for channel in mounted.bench.channels
    }


def specimen(mounted: Mounted) -> str:
    """Which specimen is mounted, and how long: its zeros belong to it."""
    file = mounted.specimen_file
    return f"{file.type} {file.serial}, {file.mounted.length:g} m, {file.mounted.date}"


def out_of_date(session: Mapping[str, Any], mounted: Mounted, now: datetime) -> str:
    """Why a kept session does not count for this bench now, in words; empty where it counts."""
    if not session:
        return "there is none yet"
    try:
        begun, ends = (datetime.fromisoformat(session[key]) for key in ("at", "valid_until"))
        if not begun <= now + timedelta(minutes=1):
            return "it is from the future: the clock of this computer was changed"
        if now >= ends:
            return f"it has run out: it is {in_words((now - begun).total_seconds())} old"
        if session["specimen"] != specimen(mounted):
            return f"another specimen is mounted now; then it was {session['specimen']}"
        if session["calibrations"] != calibrations(mounted):
            names = sorted(
                name for name, one in calibrations(mounted).items() if session["calibrations"].get(name) != one
            )
            return f"channels or calibrations have changed: {', '.join(names) or 'one is gone'}"
        missing = sorted(set(mounted.session.zeros if mounted.session is not None else ()) - set(session["zeros"]))
        if missing:
            return f"it has no zero of {', '.join(missing)}"
    except (KeyError, TypeError, ValueError, AttributeError):
        return "what is kept of it cannot be read"
    return _disturbed(mounted.bench.name, begun)


def _disturbed(bench: str, since: datetime) -> str:
    """Whether the bench was tripped, ended uncleanly or was reset since then, by its journal."""
    lines: list[dict[str, Any]] = []
    with suppress(OSError):
        for text in (Station(bench).folder / "journal.jsonl").read_text("utf-8").splitlines():
            with suppress(ValueError):
                lines.append(json.loads(text))
    for line in lines:
        with suppress(KeyError, TypeError, ValueError):
            at = datetime.fromisoformat(str(line["at"]))
            if at >= since.replace(microsecond=0) and (line["what"] == "tripped" or line.get("why") == "reset"):
                return f"the bench was {'reset' if line.get('why') == 'reset' else 'tripped'} since then"
    return ""


def utc_now() -> datetime:
    """The wall clock."""
    return datetime.now(UTC)
