"""Many runs, each on its own: what did not change is taken from the last time, the rest is worked out, in one order.

Nothing heavy is imported here, so that a second pass over an archive costs no more than looking at it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmabench.analysis.many import Pool, share
from pmabench.base.errors import RecordError
from pmabench.report.many.processed import lost, process_batch, without_trials
from pmabench.store.analyses import made_from
from pmabench.store.catalogue import Task
from pmabench.store.since import program

Progress = Callable[[int, int, int], None]
"""Called with the number of runs that are done, of all, and of those that had not changed."""
RESULTS = ("computed", "unchanged")
"""States of entries with coefficients."""
WORST = (7, 3, 1, 6)
"""Exit codes, the worst first."""


@dataclass(frozen=True)
class Many:
    """What came out, in the order of the tasks."""

    out: Path
    entries: tuple[tuple[str, str, str], ...]
    """Of each run: its path, its state (`computed`, `unchanged`, `skipped`, `failed`), and its entry as JSON."""
    exit_code: int
    """0; else the worst: record not written 7, a run that cannot be used 3, an error in the program 1, verdict 6."""

    @property
    def key(self) -> str:
        """Hash of all results in their order, and of the program."""
        digest = hashlib.sha256(program().encode())
        for path, state, text in self.entries:
            if state in RESULTS:
                digest.update(f"{path}\0{text}\0".encode())
        return digest.hexdigest()

    def of(self, *states: str) -> Iterator[dict[str, Any]]:
        """Entries of these states, each with `path` and `state` before what `process_one` returned."""
        for path, state, text in self.entries:
            if state in states:
                yield {"path": path, "state": state, **json.loads(text)}

    def results(self) -> Iterator[dict[str, Any]]:
        """Entries with coefficients."""
        return self.of(*RESULTS)

    def count(self, *states: str) -> int:
        """Number of runs in these states."""
        return sum(state in states for _, state, _ in self.entries)


def process_many(
    tasks: Sequence[Task],
    out: Path,
    pool: Pool | None = None,
    progress: Progress | None = None,
    options: Mapping[str, Any] | None = None,
    *,
    fresh: bool = False,
) -> Many:
    """Write the analysis of each task below `out`, where it was not done before, and remember what came out.

    `options`: kind -> those of its reduction, plain data. `fresh`: compute every run. What is wrong with a
    run is in its entry. Raises RecordError where `out` cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{out}: cannot be made: {error.strerror or error}") from error
    options = dict(options or {})
    keys = [made_from.key_of(task.chain, options) for task in tasks]
    found: dict[int, tuple[str, str]] = {}
    codes: set[int] = set()
    for number, task in enumerate(tasks):
        before = {} if fresh else made_from.kept(out / task.place, keys[number], options).entry
        before = before or without_trials(task.path)
        if before:
            found[number] = ("skipped" if "skipped" in before else "unchanged", json.dumps(before, allow_nan=False))
            codes |= _code(before)
    unchanged = len(found)
    left = [number for number in range(len(tasks)) if number not in found]
    here = str(out.absolute())
    things = [
        {
            "path": str(tasks[number].path.absolute()),
            "out": here,
            "folder": tasks[number].place,
            "options": options,
            "key": keys[number],
        }
        for number in left
    ]
    if progress is not None:
        progress(unchanged, len(tasks), unchanged)
    for index, entry in share(things, process_batch, lost, pool):
        number = left[index]
        found[number] = ("failed" if "error" in entry else "computed", json.dumps(entry, allow_nan=False))
        codes |= _code(entry)
        if progress is not None:
            progress(len(found), len(tasks), unchanged)
    entries = tuple((str(task.path), *found[number]) for number, task in enumerate(tasks))
    return Many(out, entries, next((code for code in WORST if code in codes), max(codes, default=0)))


def _code(entry: Mapping[str, Any]) -> set[int]:
    """The exit code that an entry asks for."""
    return {int(entry["exit_code"])} if "error" in entry else {6} if entry.get("verdicts") else set()
