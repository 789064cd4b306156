"""The feeds of all viewers, the one thread that reads run folders for them, and which run an address of the page means.

`/` is the newest run of the folder, and the next one when it begins; `/run/ID` one run; `/campaign/NAME` the newest run
of a campaign, `/session/DATE` that of a day, with the others of it.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from pmabench.base.errors import InvalidFile
from pmabench.base.system import give_back_memory
from pmabench.display.web.feed import Feed
from pmabench.display.wording import about_run, clean
from pmabench.store import folder as files
from pmabench.store.folder import read_manifest, read_seal, status_of
from pmabench.store.livestream import pa

PERIOD = 0.1
"""Runs that somebody looks at are read so often [s] ..."""
IDLE = 1.0
"""... and the newest one so often where nobody does, so that its history is there at once."""
LOOK = 1.0
"""How often it is looked for newer runs [s]."""
MOST_FEEDS = 6
"""Runs that are held at once."""
KEPT = 60.0
"""A run that nobody looks at any more is held so long [s]."""


class Room:
    """Run folders below one place, for any number of viewers."""

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
        """Begin to read."""
        self._look(time.monotonic())
        self._thread.start()

    def stop(self) -> None:
        """Read no more; viewers see that in `over`."""
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
        """How many streams are open."""
        with self._lock:
            return sum(feed.viewers for feed in self._feeds.values())

    def feed_of(self, folder: Path) -> Feed:
        """The feed of a run folder; a run that nobody looks at may be let go for it."""
        with self._lock:
            feed = self._feeds.get(folder.name)
            if feed is None:
                idle = sorted((f for f in self._feeds.values() if not f.viewers), key=lambda f: f.left_at)
                for old in idle[: max(0, len(self._feeds) + 1 - MOST_FEEDS)]:
                    del self._feeds[old.id]
                feed = self._feeds[folder.name] = Feed(folder, vent=self._vent)
            return feed

    def enter(self, feed: Feed) -> None:
        """A viewer begins to look at a run."""
        with self._lock:
            feed.viewers += 1
            self._feeds[feed.id] = feed

    def leave(self, feed: Feed) -> None:
        """A viewer looks at it no more."""
        with self._lock:
            feed.viewers -= 1
            feed.left_at = time.monotonic()

    def _read(self) -> None:
        """Poll by an absolute clock: a pause of fixed length after the work would lose frames."""
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
        """Find the newest run, and let go of runs that nobody looks at."""
        with suppress(OSError):
            self.newest = self.places.run_at("/")
        if self.newest is not None:
            self.feed_of(self.newest)
        with self._lock:
            for feed in list(self._feeds.values()):
                if not feed.viewers and feed.folder != self.newest and now - feed.left_at > KEPT:
                    del self._feeds[feed.id]


LISTED = 200
"""Newest runs that are looked at for a list."""
SHOWN = 40
"""Runs of a list."""


class Places:
    """The runs of one folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._known: dict[str, dict[str, Any]] = {}
        """Runs that have ended, by the name of their folder."""

    def run_at(self, address: str) -> Path | None:
        """The run folder that an address means now; None where there is none."""
        what, _, name = address.strip("/").partition("/")
        name = unquote(name)
        if not what:
            return self._newest()
        if what == "run":
            if name in {"", ".", ".."} or len(name) > 255 or any(sign in name for sign in "/\\\0"):
                return None
            return self.root / name if (self.root / name / files.MANIFEST).is_file() else None
        listed = self.listed(address)
        return self.root / listed[0]["id"] if listed else None

    def listed(self, address: str, run: Path | None = None) -> list[dict[str, Any]]:
        """The runs of a campaign or of a day, newest first; for other addresses those of the run's campaign or day."""
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

    def _newest(self) -> Path | None:
        runs = []
        for path in self.root.glob(f"*/{files.MANIFEST}"):
            with suppress(OSError):
                runs.append((path.stat().st_mtime, path.parent))
        return max(runs)[1] if runs else None

    def _about(self, run: Path) -> dict[str, Any] | None:
        """What a list says of a run; None where it cannot be read."""
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
