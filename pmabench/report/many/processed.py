"""One run on its own from folder to analysis, for whoever does many: plain data in, plain data out, never an exception.

Knows loading, reducing and writing of one run with those that it continues; not how many there are, nor who asks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.analysis.many import stopped
from pmabench.base.errors import InvalidFile, PmaError
from pmabench.store.folder import plain, read_manifest

WITHOUT_TRIALS = ("session", "self-test", "calibration", "setup")
"""Kinds of runs that have no trials: what they found is in their events."""


def process_batch(things: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What came out of each of `things`: `path` of a run, analysis `folder` to write below `out`, `options` by kind."""
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
        kind = read_manifest(path).get("kind")
        if kind in WITHOUT_TRIALS:
            return {"skipped": f"is a run of kind {kind}"}
    return {}


def _entry(thing: Mapping[str, Any]) -> dict[str, Any]:
    from pmabench.kinds.reduce import reduce_runs, specimen_of, verdicts
    from pmabench.report.files.csv_files import write_with_tables
    from pmabench.report.words.names import declared
    from pmabench.store.analyses.made_from import keep
    from pmabench.store.chain import open_chains

    folder, options = thing["folder"], thing.get("options") or {}
    place = Path(thing["out"], folder)
    runs = open_chains([Path(thing["path"])])
    (analysis,) = reduce_runs(runs, options)
    written = write_with_tables(analysis, place / analysis.kind)
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
                {
                    "symbol": e.symbol,
                    "coordinate": e.coordinate,
                    "at": dict(e.at),
                    "value": e.value,
                    "unit": e.unit,
                    "quantity": e.quantity,
                    "ci95": None if e.ci95 is None else list(e.ci95),
                    "half_width": e.parts.combined,
                    "n": e.n,
                    "method": e.method,
                }
                for e in analysis.estimates
            ],
            "dropped": len(analysis.dropped),
            "findings": {
                level: sum(f.level == level for f in analysis.findings) for level in ("fault", "doubt", "note")
            },
            "verdicts": verdicts(runs, [analysis]),
            "excluded": [
                {"run": run.id, "trial": note.excluded, "because": note.because, "operator": note.operator}
                for run in runs
                for note in run.notes
                if note.exclude is not None
            ],
            "since": {run.id: run.since.as_data() for run in runs if run.since.sentences},
        }
    )
    keep(place, thing.get("key", ""), [Path(run.path) for run in runs], options, [written], entry)
    return entry
