"""What came out of each run the last time, in an SQLite file next to the analyses; it may be lost at any time.

An entry counts as long as its key is the same, a hash of the run, what was said of it, the program and its
options, and the files of its analysis are those that were written. Standard library only.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from pmabench.store.since import stamp

CACHE = ".processed.sqlite"
TABLE = ""
"""In place of the path of a run: the table of all of them."""
_VERSION = 1


def load(out: Path, only: str | None = None) -> dict[str, tuple[str, str]]:
    """Place of a run -> key and entry (as JSON) of the last time; nothing where there is no cache that can be used.

    Of all runs, or of the place `only`.
    """
    path = out / CACHE
    if not path.is_file():
        return {}
    with suppress(sqlite3.Error, ValueError, TypeError, OSError), closing(_open(path, "ro")) as base:
        if base.execute("PRAGMA user_version").fetchone()[0] == _VERSION:
            asked = "SELECT place, key, told FROM runs WHERE place = ? OR ? IS NULL"
            return {place: (key, entry) for place, key, entry in base.execute(asked, (only, only))}
    return {}


def entry(kept: tuple[str, str] | None, key: str, out: Path) -> dict[str, Any] | None:
    """The entry that was kept, where it still counts: same key, same files of its analysis."""
    if kept is None or not key or kept[0] != key:
        return None
    with suppress(ValueError, TypeError, KeyError):
        entry = json.loads(kept[1])
        if isinstance(entry, dict) and ("skipped" in entry or stamp(out / entry["folder"]) == entry["stamp"]):
            return entry
    return None


def table_written(out: Path, key: str, paths: Iterable[Path]) -> bool:
    """Whether the table of these results lies at `paths` as it was written."""
    kept = load(out, TABLE).get(TABLE)
    return kept is not None and kept == (key, _stamps(paths)) != (key, "")


def keep_table(out: Path, key: str, paths: Iterable[Path]) -> None:
    """Remember that the table of these results was written."""
    store(out, {TABLE: (key, _stamps(paths))})


def _stamps(paths: Iterable[Path]) -> str:
    with suppress(OSError):
        infos = [path.stat() for path in paths]
        return json.dumps([[info.st_size, info.st_mtime_ns] for info in infos])
    return ""


def store(out: Path, fresh: Mapping[str, tuple[str, str]]) -> None:
    """Keep entries for the next time; a cache that cannot be used is made anew, or left out."""
    for _attempt in range(2):
        try:
            with closing(_open(out / CACHE, "rwc")) as base, base:
                if base.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
                    base.execute("DROP TABLE IF EXISTS runs")
                    base.execute(f"PRAGMA user_version = {_VERSION}")
                base.execute("CREATE TABLE IF NOT EXISTS runs (place TEXT PRIMARY KEY, key TEXT, told TEXT)")
                rows = [(place, key, entry) for place, (key, entry) in fresh.items()]
                base.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?)", rows)
            return
        except sqlite3.OperationalError:
            return
        except sqlite3.DatabaseError:
            with suppress(OSError):
                (out / CACHE).unlink()


def _open(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=0.5)
