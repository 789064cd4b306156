"""One run for its viewers: one thread reads it on, the thread of each viewer asks; nothing here waits for a viewer."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.analysis.trial import Expected
from pmabench.display.follow import Block, StreamTail
from pmabench.display.state import RunState
from pmabench.display.verdicts import prepare, read_expected
from pmabench.display.web import picture
from pmabench.display.web.buckets import FINE, WIDTHS, Buckets, Piece, level_for
from pmabench.display.web.loop import Loops
from pmabench.display.wording import quantity

LONGEST_FRAME = 10.0
"""A frame begins at most so long before the newest sample [s]; what is older a viewer asks for as history."""
RENEWED = 0.25
"""The parts of the page are made so often [s]; values and curves come with each frame."""
AT_REST = 1.0
"""Values are sent so often [s] while no sample is new, so that their age is seen."""
MOST = 2500
"""Most buckets of a channel in an answer."""


@dataclass
class Seen:
    """What one viewer has got of a run."""

    versions: dict[str, int] = field(default_factory=dict)
    """Version of each part of the page."""
    buckets: dict[str, int] = field(default_factory=dict)
    """Number of the last narrow bucket of each stream."""
    loop: tuple[float, int, int] = (-1.0, -1, 0)
    """Begin and version of the loop, and its number of points."""
    at: float = 0.0
    """When values were sent [s, monotonic]."""


class Feed:
    """One run folder, for any number of viewers."""

    def __init__(self, folder: Path, *, vent: bool = False) -> None:
        """With `vent`, the bench file of the run may allow the vent button."""
        self.folder = folder
        self.buckets = Buckets()
        self.state = RunState(folder, self._keep)
        self.viewers = 0
        self.left_at = time.monotonic()
        """When the last viewer left [s]."""
        self.may_vent: bool | None = None
        """Whether the button may be shown; None until the bench file was read, which is before any sample."""
        self._vent = vent
        self._loops = Loops()
        self._lock = threading.Lock()
        self._parts: dict[str, tuple[int, str]] = {}
        self._values: dict[str, list[Any]] = {}
        self._expected: Expected | None = None
        self._kept: tuple[tuple[Any, ...], dict[str, Any]] = ((), {})
        self._count = 0
        self._made: dict[tuple[str, int, int], dict[str, Any]] = {}
        """Frames of this reading, which most viewers get alike."""
        self._renewed = -RENEWED
        self._behind = True

    def _keep(self, stream: StreamTail, block: Block) -> None:
        self._read_bench()
        self.buckets.add(stream.name, block.t, block.values, block.flags)

    def _read_bench(self) -> None:
        if self.may_vent is None:
            self.may_vent = self._vent and picture.may_vent(self.folder)

    @property
    def id(self) -> str:
        """Name of the run folder."""
        return self.folder.name

    def poll(self) -> bool:
        """Read what is new; whether more waits to be read at once."""
        before = self.state.files.there
        behind = self.state.poll()
        if self.state.files.there and not before:
            self._read_bench()
            self._expected = read_expected(self.folder)
            threading.Thread(target=prepare, args=(self.state.kind,), daemon=True).start()
        with self._lock:
            self._loops.update(self.state)
        self._values = picture.values_of(self.state)
        self._made = {}
        now = time.monotonic()
        if now - self._renewed >= RENEWED or behind != self._behind:
            self._renewed, self._behind = now, behind
            self._renew(behind)
        return behind

    def _renew(self, behind: bool) -> None:
        """Make the parts of the page anew; those that are as they were keep their version."""
        state = self.state
        trials = len(state.lines), state.done, state.files.there, id(state.lines)
        if self._kept[0] != trials:
            coefficients = picture.coefficients_part(state, self._expected) if state.files.there else []
            self._kept = trials, {"trials": picture.trials_part(state), "coefficients": coefficients}
        loops = [{"number": loop.number, "points": loop.points} for loop in self._loops.before]
        parts = {
            "run": picture.run_part(state, self.folder.parent, vent=bool(self.may_vent)) | {"reading": behind},
            "now": picture.now_part(state),
            "channels": picture.channels_part(state),
            "log": picture.log_part(state),
            "loops": loops,
            **self._kept[1],
        }
        for name, part in parts.items():
            text = json.dumps(part, separators=(",", ":"))
            if name not in self._parts or self._parts[name][1] != text:
                self._count += 1
                self._parts[name] = self._count, text

    def fresh(self, seen: Seen) -> list[tuple[str, str]]:
        """Name and JSON of what a viewer has not got yet; `seen` is brought up to date."""
        messages = []
        for name, (version, text) in list(self._parts.items()):
            if seen.versions.get(name) != version:
                seen.versions[name] = version
                messages.append((name, text))
        # A page that hears which run it is drops what came before: the loop of a trial would be lost.
        frame = self._frame(seen) if self._parts else {}
        if frame:
            messages.append(("frame", json.dumps(frame, separators=(",", ":"))))
        return messages

    def _frame(self, seen: Seen) -> dict[str, Any]:
        """Newest buckets, values and points of the loop; empty where no sample is new."""
        frame: dict[str, Any] = {}
        pieces = self.buckets.newest(seen.buckets)
        streams = {}
        for name, piece in pieces.items():
            last = int(piece.k[-1])
            first = int(np.searchsorted(piece.k, last - LONGEST_FRAME / WIDTHS[0]))
            cut = Piece(piece.names, piece.k[first:], piece.low[first:], piece.high[first:])
            if seen.buckets.get(name) != last:
                key = name, int(cut.k[0]), last
                if key not in self._made:
                    self._made[key] = self._as_data(cut)
                streams[name] = self._made[key]
            seen.buckets[name] = last
        if streams:
            frame["streams"] = streams
        with self._lock:
            loop = self._loops.now
            if loop is not None:
                same = seen.loop[:2] == (loop.begin, loop.version)
                start = seen.loop[2] if same else 0
                if not same or len(loop.points) > start:
                    frame["loop"] = {"number": loop.number, "start": start, "points": loop.points[start:]}
                seen.loop = loop.begin, loop.version, len(loop.points)
        if frame or time.monotonic() - seen.at > AT_REST:
            frame["values"] = self._values
            seen.at = time.monotonic()
        return frame

    def _as_data(self, piece: Piece) -> dict[str, Any]:
        """Buckets of one stream for the page, in the units that people read; missing values are null."""
        channels = {}
        for column, name in enumerate(piece.names):
            channel = self.state.channels.get(name)
            if channel is None:
                continue
            scale, digits = quantity(channel.quantity).scale, picture.digits_of(channel) + 1
            ends = np.round(np.stack([piece.low[:, column], piece.high[:, column]]).astype(float) / scale, digits)
            channels[name] = [[None if v != v else v for v in end] for end in ends.tolist()]
        return {"k": piece.k.tolist(), "channels": channels}

    def history(self, begin: float | None, end: float | None, span: float | None, most: int) -> dict[str, Any]:
        """Buckets from `begin` to `end` [s], or of the last `span` [s], or of all: at most `most` of each channel."""
        first, last = self.buckets.span
        end = last if end is None else min(end, last)
        if begin is None:
            begin = first if span is None else end - span
        begin = max(begin, first)
        level = level_for(max(end - begin, span or 0.0, 1e-3), min(most, MOST))
        if level == 0 and begin < last - FINE:
            level = 1
        pieces = self.buckets.between(begin, end, level)
        streams = {name: self._as_data(piece) for name, piece in pieces.items()}
        return {"run": self.id, "width": WIDTHS[level], "first": first, "last": last, "streams": streams}
