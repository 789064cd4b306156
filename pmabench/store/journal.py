"""Lines of JSON that show when one is torn, altered, missing or out of place; counts trials.

A line is `{"seq":3,"t":1.5,"kind":"command","data":{...},"crc":"0a1b2c3d"}`. The crc32 covers the bytes before
`,"crc"` and begins with the value of the line before (0 for the first), so that lines form a chain.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pmabench.store.folder import plain


def encode(seq: int, t: float, kind: str, data: Mapping[str, Any], before: int) -> tuple[bytes, int]:
    """One line and its crc, which the next line needs as `before`."""
    entry = {"seq": seq, "t": round(float(t), 9), "kind": kind, "data": plain(data)}
    body = json.dumps(entry, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()[:-1]
    crc = zlib.crc32(body, before)
    return body + b',"crc":"%08x"}\n' % crc, crc


@dataclass(frozen=True)
class Journal:
    """The lines up to the first that is not whole, and what was wrong with that one (empty: nothing)."""

    lines: tuple[dict[str, Any], ...]
    fault: str = ""


def decode(raw: bytes, seq: int = 0, crc: int = 0) -> Journal:
    """Every whole line from the start on; nothing after a bad one is believed.

    Where `raw` goes on after lines that were read before, `seq` is their number and `crc` that of the last of them.
    """
    lines: list[dict[str, Any]] = []
    for number, line in enumerate(raw.split(b"\n"), start=1):
        if not line and number > raw.count(b"\n"):
            break
        body, mark, tail = line.rpartition(b',"crc":"')
        crc = zlib.crc32(body, crc)
        if not mark or tail != b'%08x"}' % crc:
            torn = number > raw.count(b"\n")
            return Journal(tuple(lines), f"line {number} is {'torn' if torn else 'altered'}: its crc32 does not fit")
        try:
            entry = json.loads(body + b"}")
        except (ValueError, RecursionError):
            return Journal(tuple(lines), f"line {number} is not JSON")
        if entry.get("seq") != seq + len(lines) or not {"t", "kind", "data"} <= entry.keys():
            return Journal(tuple(lines), f"line {number} should have seq {seq + len(lines)}")
        lines.append(entry)
    return Journal(tuple(lines))


def summary(manifest: Mapping[str, Any], journal: Journal, spans: list[tuple[float, float]]) -> dict[str, Any]:
    """Trials planned and finished, and the duration [s] from the first to the last sample or event.

    A reference trial that was done again is none of the plan's.
    """
    ends = [line["data"] for line in journal.lines if line["kind"] == "trial-end"]
    begins = [line["data"] for line in journal.lines if line["kind"] == "trial-begin"]
    again = {begin.get("trial") for begin in begins if begin.get("again")}
    begun = {begin.get("trial") for begin in begins} - again
    times = [line["t"] for line in journal.lines] + [t for span in spans for t in span]
    return {
        "trials_planned": max(int(manifest.get("trials_planned") or 0), len(begun)),
        "trials_finished": len({end.get("trial") for end in ends if end.get("status") == "finished"} - again),
        "duration": max(times) - min(times) if times else None,
    }
