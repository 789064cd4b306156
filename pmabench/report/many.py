"""Many runs, each processed separately, with one table over all; unchanged runs keep their last results.

Each is loaded, reduced and written from plain data to plain data, never with an exception, in whatever process does it.
Nothing that reduces is imported here, so that a second pass over an archive costs no more than looking at it. The table
has a row per run, method and operating point, numbers in display units; the same results give the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench.base.errors import InvalidFile, PmaError, RecordError
from pmabench.plotting.wording import POINTS, in_order, point_shown, shown, symbol_text
from pmabench.report.files.csv_files import csv_text, plain_head, write_with_tables
from pmabench.report.words import declared, in_common
from pmabench.report.writing import writing
from pmabench.store.analyses import folder as made_from
from pmabench.store.catalogue import Task
from pmabench.store.folder import plain, read_manifest
from pmabench.store.records import RunData

if TYPE_CHECKING:
    from pmabench.analysis.many import Pool

Progress = Callable[[int, int, int], None]
"""Called with the number of runs that are done, of all, and of those that had not changed."""
RESULTS = ("computed", "unchanged")
"""States of entries with coefficients."""
WORST = (7, 3, 1, 6)
"""Exit codes, the worst first."""


@dataclass(frozen=True)
class Many:
    """The results of many runs, in the order of the tasks."""

    out: Path
    entries: tuple[tuple[str, str, str], ...]
    """Of each run: its path, its state (`computed`, `unchanged`, `skipped`, `failed`), and its entry as JSON."""
    exit_code: int
    """0; else the worst: record not written 7, a run that cannot be used 3, an error in the program 1, verdict 6."""

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
    common = {"out": str(out.absolute()), "options": options}
    about = ((tasks[number], keys[number]) for number in left)
    things = [{"path": str(t.path.absolute()), "folder": t.place, "key": key, **common} for t, key in about]
    progress = progress or (lambda _done, _total, _unchanged: None)
    progress(unchanged, len(tasks), unchanged)
    from pmabench.analysis.many import share

    for index, entry in share(things, process_batch, lost, pool):
        number = left[index]
        found[number] = ("failed" if "error" in entry else "computed", json.dumps(entry, allow_nan=False))
        codes |= _code(entry)
        progress(len(found), len(tasks), unchanged)
    entries = tuple((str(task.path), *found[number]) for number, task in enumerate(tasks))
    return Many(out, entries, next((code for code in WORST if code in codes), max(codes, default=0)))


def _code(entry: Mapping[str, Any]) -> set[int]:
    """The exit codes that follow from an entry: that of its error, 6 for a failed verdict, or none."""
    return {int(entry["exit_code"])} if "error" in entry else {6} if entry.get("verdicts") else set()


NAME = "all-runs"
SCHEMA = "pmabench.process-many/1"
FIRST = ("run", "started", "specimen", "kind", "simulated", "method")
LAST = ("trials", "not accepted", "analysis")
"""Columns before and after the numbers."""
KEPT = ("run", "runs", "kind", "started", "specimen", "simulated", "folder", "estimates", "dropped", "findings")
"""Keys of a run in JSON; verdicts and exclusions come with it."""


def write_table(many: Many) -> list[Path]:
    """`all-runs.csv` and `.json` next to the analyses; raises RecordError where they cannot be written."""
    paths = [many.out / f"{NAME}.{suffix}" for suffix in ("csv", "json")]
    rows, numbers = table_rows(many.results())
    columns = [*FIRST, *numbers, *LAST]
    with writing(many.out, "the table"):
        ordered = [{name: row.get(name) for name in columns} for row in rows]
        paths[0].write_text(csv_text(ordered, columns), encoding="utf-8", newline="")
        with paths[1].open("w", encoding="utf-8", newline="") as file:
            file.writelines(_json_lines(many))
    return paths


def plain_entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A result as in JSON, the same whether it was worked out now or before."""
    return {name: entry[name] for name in (*KEPT, "verdicts", "excluded", "since")}


def _json_lines(many: Many) -> Iterable[str]:
    """One object, a run on each line."""
    yield f'{{"schema": "{SCHEMA}",\n "runs": ['
    for n, entry in enumerate(many.results()):
        text = json.dumps(plain_entry(entry), sort_keys=True, ensure_ascii=False, allow_nan=False)
        yield f"{',' if n else ''}\n  {text}"
    yield "\n ]\n}\n"


def table_rows(entries: Iterable[Mapping[str, Any]]) -> tuple[list[dict[str, Any]], list[str]]:
    """The rows, and the columns of numbers in the order of the table."""
    rows: list[dict[str, Any]] = []
    points: set[str] = set()
    symbols: set[tuple[str, str, str, str]] = set()
    orders: dict[str, list[str]] = {}
    for entry in entries:
        orders[entry["kind"]] = entry.get("symbols") or [e["symbol"] for e in entry["estimates"]]
        about = {name: entry[name] for name in ("run", "started", "specimen", "kind", "simulated")}
        about |= {"not accepted": "; ".join(entry["verdicts"]), "analysis": entry["folder"]}
        found: dict[tuple[Any, ...], dict[str, Any]] = {}
        for e in entry["estimates"]:
            row = found.setdefault((e["method"], *sorted(e["at"].items())), {**about, "method": e["method"]})
            row["trials"] = max(row.get("trials", 0), e["n"])
            for name, value in e["at"].items():
                points.add(name)
                row[plain_head(name)] = value / point_shown(name)[1].scale
            symbol = (e["symbol"], e["coordinate"], e["quantity"], e["unit"])
            symbols.add(symbol)
            unit = shown(e["quantity"], e["unit"])
            for head, value in zip(_heads(*symbol), (e["value"], e["half_width"]), strict=True):
                row[head] = unit.of(value)
        rows += found.values()
    numbers = [plain_head(name) for name in in_order(sorted(points), POINTS)]
    for name in in_common(orders.values()):
        for symbol in sorted(symbol for symbol in symbols if symbol[0] == name):
            numbers += _heads(*symbol)
    return rows, list(dict.fromkeys(numbers))


def _heads(symbol: str, coordinate: str, quantity: str, unit: str) -> list[str]:
    text, in_unit = symbol_text(symbol, coordinate), shown(quantity, unit)
    return [in_unit.plain_label(head) for head in (text, f"{text} half width 95 %")]


ESTIMATE = ("symbol", "coordinate", "at", "value", "unit", "quantity", "ci95", "n", "method")
"""Fields of an estimate that are kept."""
WITHOUT_TRIALS = ("session", "self-test", "calibration", "setup")
"""Kinds of runs that have no trials: what they found is in their events."""


def process_batch(things: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Process each of `things`: `path` of a run, analysis `folder` to write below `out`, `options` by kind."""
    from pmabench.analysis.many import stopped

    return [] if stopped() else [process_one(thing) for thing in things]


def lost(thing: Mapping[str, Any], why: str) -> dict[str, Any]:
    """The result of a run on which the process that worked on it died."""
    return {
        "error": f"{thing['path']}  the process that worked on it died ({why}); give this run alone",
        "exit_code": 1,
    }


def process_one(thing: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of a run in the table of many: `error` and `exit_code` where it cannot be processed."""
    try:
        return _entry(thing)
    except InvalidFile as error:
        return {"error": str(error), "exit_code": error.exit_code}
    except PmaError as error:
        return {"error": f"{thing['path']}  {error}", "exit_code": error.exit_code}
    except Exception as error:
        message = str(error).splitlines()[0] if str(error) else ""
        what = f"an error in the program, please report it: {type(error).__name__}: {message}"
        return {"error": f"{thing['path']}  {what}", "exit_code": 1}


def without_trials(path: Path) -> dict[str, Any]:
    """The entry of a run that has no trials; empty for any other, and where its manifest cannot be read."""
    with suppress(InvalidFile):
        if (kind := read_manifest(path).get("kind")) in WITHOUT_TRIALS:
            return {"skipped": f"is a run of kind {kind}"}
    return {}


def added_to(runs: Sequence[RunData]) -> dict[str, Any]:
    """What notes leave out of runs, and what came to them after they were closed, as it is in JSON."""
    excluded = [
        {"run": run.id, "trial": note.excluded, "because": note.because, "operator": note.operator}
        for run in runs
        for note in run.notes
        if note.exclude is not None
    ]
    return {"excluded": excluded, "since": {run.id: run.since.as_data() for run in runs if run.since.sentences}}


def _entry(thing: Mapping[str, Any]) -> dict[str, Any]:
    from pmabench.kinds.reduce import reduce_runs, specimen_of, verdicts
    from pmabench.store.chain import open_chains

    folder, options = thing["folder"], thing.get("options") or {}
    place = Path(thing["out"], folder)
    runs = open_chains([Path(thing["path"])])
    (analysis,) = reduce_runs(runs, options)
    written = write_with_tables(analysis, place / analysis.kind)
    levels = [f.level for f in analysis.findings]
    entry: dict[str, Any] = plain(
        {
            "run": runs[-1].id,
            "runs": [run.id for run in runs],
            "kind": analysis.kind,
            "started": str(runs[0].manifest.get("started_utc", "")),
            "specimen": specimen_of(runs[-1]),
            "simulated": analysis.simulated,
            "folder": f"{folder}/{analysis.kind}",
            "symbols": list(declared([analysis])),
            "estimates": [
                {name: getattr(e, name) for name in ESTIMATE} | {"half_width": e.parts.combined}
                for e in analysis.estimates
            ],
            "dropped": len(analysis.dropped),
            "findings": {level: levels.count(level) for level in ("fault", "doubt", "note")},
            "verdicts": verdicts(runs, [analysis]),
            **added_to(runs),
        }
    )
    made_from.keep(place, thing.get("key", ""), [Path(run.path) for run in runs], options, [written], entry)
    return entry
