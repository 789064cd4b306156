"""The feeds of all viewers, and the one thread that reads run folders for them."""

from __future__ import annotations

import json
import threading
import time
from contextlib import suppress
from pathlib import Path

from pmabench.base.system import give_back_memory
from pmabench.display.web.feed import Feed
from pmabench.display.web.places import Places
from pmabench.store.arrow import pa

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
        self._first: Path | None = None

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

    def newest(self) -> Path | None:
        """The newest run."""
        return self._first

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

    def list_of(self, address: str, folder: Path | None) -> str:
        """JSON of the runs that belong to an address."""
        return json.dumps(self.places.listed(address, folder), separators=(",", ":"))

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
                    if feed.viewers or feed.folder == self._first:
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
            self._first = self.places.run_at("/")
        if self._first is not None:
            self.feed_of(self._first)
        with self._lock:
            for feed in list(self._feeds.values()):
                if not feed.viewers and feed.folder != self._first and now - feed.left_at > KEPT:
                    del self._feeds[feed.id]
