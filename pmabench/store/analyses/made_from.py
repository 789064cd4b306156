"""What analyses were made from: the record `.made-from.json` next to them, and whether it still describes them.

Analyses are taken from the last time only where runs, notes, options and program are the same (`key_of`), and where
their files are those that were written. Standard library only, so that thousands of records are read in a second.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmabench.store import folder as files
from pmabench.store.folder import open_regular, sha256_of
from pmabench.store.since import fingerprint, program, stamp

RECORD = ".made-from.json"
SCHEMA = "pmabench.made-from/1"
LONGEST = 50_000_000
"""Bytes of a record that is read."""


@dataclass(frozen=True)
class Kept:
    """The analyses of the last time that can be used; without `folders` none can."""

    folders: tuple[Path, ...] = ()
    entry: Mapping[str, Any] = field(default_factory=dict)
    """What else was remembered with them."""
    why: str = ""
    """Why they are not used, where a user would wonder."""


def key_of(runs: Iterable[Path], options: Mapping[str, Any]) -> str:
    """Hash of runs (with those that they continue), of options by kind and of the program; empty for an open run."""
    return fingerprint(runs, f"{program()} {json.dumps(options, sort_keys=True)}")


def keep(
    place: Path,
    key: str,
    runs: Iterable[Path],
    options: Mapping[str, Any],
    folders: Sequence[Path],
    entry: Mapping[str, Any] | None = None,
) -> None:
    """Record what the analyses in `folders`, all in `place`, were made from; without a key they get no record."""
    with suppress(OSError):
        (place / RECORD).unlink(missing_ok=True)
        if key:
            record = {
                "schema": SCHEMA,
                "key": key,
                "program": program(),
                "options": options,
                "runs": {run.name: sha256_of(run / files.SEAL) for run in runs},
                "analyses": {folder.name: stamp(folder) for folder in folders},
                "entry": dict(entry or {}),
            }
            (place / RECORD).write_text(json.dumps(record, allow_nan=False), encoding="utf-8")


def kept(place: Path, key: str, options: Mapping[str, Any]) -> Kept:
    """The analyses in `place` where they are those of `key`, which is that of `options` and of runs."""
    try:
        with open_regular(place / RECORD) as file:
            record = json.loads(file.read(LONGEST))
        found, before, entry = record["analyses"], record["options"], record["entry"]
        whole = isinstance(entry, dict) and all(Path(name).name == name for name in found)
        same = whole and all(stamp(place / name) == mark != "" for name, mark in found.items())
    except FileNotFoundError:
        return Kept()
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return Kept(why=f"{place / RECORD} is damaged")
    if record.get("key") != key or not key:
        other = before != options and record.get("program") == program()
        return Kept(why=f"{place} was made with other options ({_words(before)})" if other else "")
    if not same:
        return Kept(why=f"{place} was changed after it was written")
    return Kept(tuple(place / name for name in found), entry)


def _words(options: Any) -> str:
    """Options by kind as people give them; `none` for none."""
    mine = [one for one in options.values() if isinstance(one, Mapping)] if isinstance(options, Mapping) else []
    return ", ".join(dict.fromkeys(str(name) for one in mine for name in one)) or "none"
