"""The runs that are being viewed, each with its feed, and the single thread that reads run folders for them.

The thread of each viewer asks its feed for new data; nothing here waits for a viewer. Addresses: `/` is the newest run
of the folder, and the next one when it begins; `/run/ID` one run; `/campaign/NAME` the newest run of a campaign,
`/session/DATE` that of a day, each with a list of the other runs.
"""

from __future__ import annotations

import json
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from pmabench.analysis.trial import Expected
from pmabench.base.errors import InvalidFile
from pmabench.base.system import give_back_memory
from pmabench.display.follow import Block, StreamTail
from pmabench.display.state import RunState
from pmabench.display.verdicts import prepare, read_expected
from pmabench.display.web import picture
from pmabench.display.web.series import FINE, WIDTHS, Buckets, Loops, Piece, level_for
from pmabench.display.wording import about_run, clean, quantity
from pmabench.store import folder as files
from pmabench.store.folder import newest_run, read_manifest, read_seal, status_of
from pmabench.store.livestream import pa

LONGEST_FRAME = 10.0
"""Longest time range of a frame, up to the newest sample [s]; older data are requested as history."""
RENEWED = 0.25
"""Interval for renewing the parts of the page [s]; values and curves are sent with each frame."""
AT_REST = 1.0
"""Interval for sending values without new samples [s], so that their age is visible."""
MOST = 2500
"""Most buckets of a channel in one answer."""


@dataclass
class Seen:
    """What one viewer has received of a run."""

    versions: dict[str, int] = field(default_factory=dict)
    """Version of each part of the page."""
    buckets: dict[str, int] = field(default_factory=dict)
    """Number of the last narrow bucket of each stream."""
    loop: tuple[float, int, int] = (-1.0, -1, 0)
    """Begin and version of the loop, and its number of points."""
    at: float = 0.0
    """When values were last sent [s, monotonic]."""


class Feed:
    """One run folder, for any number of viewers."""

    def __init__(self, folder: Path, *, vent: bool = False) -> None:
        """With `vent`, the bench file of the run may allow the vent button."""
        self.folder = folder
        self.buckets = Buckets()
        self.state = RunState(folder, self._keep)
        self.viewers = 0
        self.left_at = time.monotonic()
        """When the last viewer left [s, monotonic]."""
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
        """Frames of this reading, as most viewers get the same."""
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
        """Read new data; returns whether more can be read at once."""
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
        """Renew the parts of the page; unchanged ones keep their version."""
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
        """Name and JSON of parts that a viewer has not received; updates `seen`."""
        messages = []
        for name, (version, text) in list(self._parts.items()):
            if seen.versions.get(name) != version:
                seen.versions[name] = version
                messages.append((name, text))
        # A page discards its data when it learns which run it shows: the loop of a trial would be lost.
        frame = self._frame(seen) if self._parts else {}
        if frame:
            messages.append(("frame", json.dumps(frame, separators=(",", ":"))))
        return messages

    def _frame(self, seen: Seen) -> dict[str, Any]:
        """New buckets, values and loop points; empty without new samples."""
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
        """Buckets of one stream for the page, in display units; missing values are null."""
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
        """Buckets from `begin` to `end` [s], or of the last `span` [s], or all; at most `most` per channel."""
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


PERIOD = 0.1
"""Interval for reading the runs with viewers [s] ..."""
IDLE = 1.0
"""... and for reading the newest run without any, so that its history is available at once."""
LOOK = 1.0
"""Interval for looking for newer runs [s]."""
MOST_FEEDS = 6
"""Largest number of runs in memory."""
KEPT = 60.0
"""How long a run without viewers is kept [s]."""


class Room:
    """Run folders in one place, for any number of viewers."""

    def __init__(self, root: Path, *, vent: bool = False) -> None:
        self.places = Places(root)
        self.changed = threading.Condition()
        """Notified after each reading."""
        self._vent = vent
        self._feeds: dict[str, Feed] = {}
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self.newest: Path | None = None
        """The newest run."""

    def start(self) -> None:
        """Start the reading thread."""
        self._look(time.monotonic())
        self._thread.start()

    def stop(self) -> None:
        """Stop reading; viewers see it in `over`."""
        self._over.set()
        with self.changed:
            self.changed.notify_all()
        self._thread.join(5.0)

    @property
    def over(self) -> bool:
        """Whether the room is closed."""
        return self._over.is_set()

    @property
    def viewers(self) -> int:
        """Number of open streams."""
        with self._lock:
            return sum(feed.viewers for feed in self._feeds.values())

    def feed_of(self, folder: Path) -> Feed:
        """The feed of a run folder; runs without viewers may be dropped for it."""
        with self._lock:
            feed = self._feeds.get(folder.name)
            if feed is None:
                idle = sorted((f for f in self._feeds.values() if not f.viewers), key=lambda f: f.left_at)
                for old in idle[: max(0, len(self._feeds) + 1 - MOST_FEEDS)]:
                    del self._feeds[old.id]
                feed = self._feeds[folder.name] = Feed(folder, vent=self._vent)
            return feed

    def enter(self, feed: Feed) -> None:
        """A viewer starts viewing a run."""
        with self._lock:
            feed.viewers += 1
            self._feeds[feed.id] = feed

    def leave(self, feed: Feed) -> None:
        """A viewer stops viewing a run."""
        with self._lock:
            feed.viewers -= 1
            feed.left_at = time.monotonic()

    def _read(self) -> None:
        """Poll at absolute times: with a fixed pause after the work the rate would fall."""
        due = time.monotonic()
        looked = -LOOK
        idle = 0.0
        was_behind = True
        while not self._over.is_set():
            now = time.monotonic()
            if now - looked >= LOOK:
                looked = now
                self._look(now)
            with self._lock:
                feeds = list(self._feeds.values())
            watched = any(feed.viewers for feed in feeds)
            if watched or was_behind or now - idle >= IDLE:
                idle, behind = now, False
                for feed in feeds:
                    if feed.viewers or feed.folder == self.newest:
                        behind |= feed.poll()
                if was_behind and not behind:
                    pa.default_memory_pool().release_unused()
                    give_back_memory()
                was_behind = behind
            with self.changed:
                self.changed.notify_all()
            due = max(due + PERIOD, now)
            if not was_behind:
                self._over.wait(max(0.0, due - time.monotonic()))

    def _look(self, now: float) -> None:
        """Find the newest run, and drop runs that have had no viewer for `KEPT`."""
        with suppress(OSError):
            self.newest = self.places.run_at("/")
        if self.newest is not None:
            self.feed_of(self.newest)
        with self._lock:
            for feed in list(self._feeds.values()):
                if not feed.viewers and feed.folder != self.newest and now - feed.left_at > KEPT:
                    del self._feeds[feed.id]


LISTED = 200
"""Most runs that are examined for a list."""
SHOWN = 40
"""Most runs in a list."""


class Places:
    """The runs of one folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._known: dict[str, dict[str, Any]] = {}
        """Summaries of runs that have ended, by folder name."""

    def run_at(self, address: str) -> Path | None:
        """The run folder that an address refers to now; None without one."""
        what, _, name = address.strip("/").partition("/")
        name = unquote(name)
        if not what:
            return newest_run(self.root)
        if what == "run":
            if name in {"", ".", ".."} or len(name) > 255 or any(sign in name for sign in "/\\\0"):
                return None
            return self.root / name if (self.root / name / files.MANIFEST).is_file() else None
        listed = self.listed(address)
        return self.root / listed[0]["id"] if listed else None

    def listed(self, address: str, run: Path | None = None) -> list[dict[str, Any]]:
        """Runs of a campaign or a day, newest first; for other addresses those of the campaign or day of `run`."""
        what, _, name = address.strip("/").partition("/")
        wanted = unquote(name)
        if what not in {"campaign", "session"}:
            about = self._about(run) if run is not None else None
            if about is None:
                return []
            what = "campaign" if about["campaign"] else "session"
            wanted = about[what]
        names = sorted((path.parent.name for path in self.root.glob(f"*/{files.MANIFEST}")), reverse=True)[:LISTED]
        found = [about for entry in names if (about := self._about(self.root / entry)) and about[what] == wanted]
        return sorted(found, key=lambda about: about["started"], reverse=True)[:SHOWN]

    def _about(self, run: Path) -> dict[str, Any] | None:
        """Summary of a run for a list; None if it cannot be read."""
        if run.name in self._known:
            return self._known[run.name]
        try:
            manifest, seal = read_manifest(run), None
            with suppress(InvalidFile):
                seal = read_seal(run)
        except (InvalidFile, OSError):
            return None
        status, trials = clean(status_of(manifest, seal)), int(manifest.get("trials_planned") or 0)
        about = {"id": run.name, **about_run(manifest), "status": status, "trials": trials}
        if seal is not None:
            self._known[run.name] = about
        return about
