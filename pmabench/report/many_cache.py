"""What came out of each run the last time, in an SQLite file beside the analyses; it may be lost at any time.

An entry counts as long as its key is the same, which stands for the run, what was said of it, the program and its
options, and the files of its analysis are those that were written. Standard library only.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from pmabench.store.fingerprint import stamp

CACHE = ".processed.sqlite"
_VERSION = 1


def load(out: Path) -> dict[str, tuple[str, str]]:
    """Place of a run -> key and entry (as JSON) of the last time; nothing where there is no cache that can be used."""
    path = out / CACHE
    if not path.is_file():
        return {}
    with suppress(sqlite3.Error, ValueError, TypeError, OSError), closing(_open(path, "ro")) as base:
        if base.execute("PRAGMA user_version").fetchone()[0] == _VERSION:
            return {place: (key, told) for place, key, told in base.execute("SELECT place, key, told FROM runs")}
    return {}


def entry(kept: tuple[str, str] | None, key: str, out: Path) -> dict[str, Any] | None:
    """The entry that was kept, where it still counts: same key, same files of its analysis."""
    if kept is None or not key or kept[0] != key:
        return None
    with suppress(ValueError, TypeError, KeyError):
        told = json.loads(kept[1])
        if isinstance(told, dict) and ("skipped" in told or stamp(out / told["folder"]) == told["stamp"]):
            return told
    return None


def store(out: Path, fresh: Mapping[str, tuple[str, str]]) -> None:
    """Keep entries for the next time; a cache that cannot be used is made anew, or left out."""
    for _attempt in range(2):
        try:
            with closing(_open(out / CACHE, "rwc")) as base, base:
                if base.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
                    base.execute("DROP TABLE IF EXISTS runs")
                    base.execute(f"PRAGMA user_version = {_VERSION}")
                base.execute("CREATE TABLE IF NOT EXISTS runs (place TEXT PRIMARY KEY, key TEXT, told TEXT)")
                rows = [(place, key, told) for place, (key, told) in fresh.items()]
                base.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?)", rows)
            return
        except sqlite3.OperationalError:
            return
        except sqlite3.DatabaseError:
            with suppress(OSError):
                (out / CACHE).unlink()


def _open(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=0.5)
