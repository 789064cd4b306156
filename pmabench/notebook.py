"""The Python interface for notebooks: runs and results as pandas tables, in SI, with units in the column names.

Reached as `pmabench.open_run`, `pmabench.process` and `pmabench.open_analysis`. Computes nothing itself, and never
writes into a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pmabench.base.errors import UsageError
from pmabench.base.quantities import QUANTITIES
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis
from pmabench.store.records import RunData, TrialData

if TYPE_CHECKING:
    from pmabench.report.document.deviations import Issuer


def open_run(path: Path | str) -> Run:
    """One run folder, finished or not, without what notes exclude; raises InvalidFile if it is no run."""
    from pmabench.store import reader

    return Run(reader.open_run(path))


def process(
    *runs: Run | Path | str,
    regulator: bool = False,
) -> Results:
    """Coefficients of runs, for each kind of test; runs that continue each other are combined.

    `regulator` is for kinds of test that have this option, as in `pmabench process`.

    Raises InvalidFile if one is no run or of a kind that cannot be reduced; UsageError if none is given.
    """
    from pmabench.kinds import registry
    from pmabench.kinds.reduce import reduce_runs
    from pmabench.store.chain import open_chains

    if not runs:
        raise UsageError("no run is given; give run folders, or what open_run returned")
    loaded = open_chains([Path(run.data.path if isinstance(run, Run) else run) for run in runs])
    options = registry.options_for({"regulator": regulator})
    return Results(tuple(reduce_runs(loaded, options)), tuple(loaded))


def open_analysis(*folders: Path | str) -> Results:
    """Analysis folders written by `pmabench process`, with those of their runs that are found next to them.

    Raises InvalidFile if one is no analysis.
    """
    from pmabench.store.analyses.folder import read_analysis, runs_of
    from pmabench.store.chain import open_chains

    paths = [Path(folder) for folder in folders]
    runs = dict.fromkeys(run for path in paths for run in runs_of(path))
    return Results(tuple(read_analysis(path) for path in paths), tuple(open_chains(list(runs))))


@dataclass(frozen=True)
class Run:
    """A run, loaded."""

    data: RunData
    """All contents of the record, as plain records."""

    @property
    def id(self) -> str:
        """Name under which it was recorded."""
        return self.data.id

    @property
    def kind(self) -> str:
        """Kind of its protocol."""
        return self.data.kind

    @property
    def status(self) -> str:
        """`finished`, or how it ended otherwise."""
        return self.data.status

    @property
    def simulated(self) -> bool:
        """Whether any of its devices was simulated."""
        return self.data.simulated

    @property
    def trials(self) -> pd.DataFrame:
        """One row for each trial, index: its number (from 1); operating point, repeat, status, begin and end [s]."""
        rows = []
        for trial in self.data.trials:
            ends = (float(trial.t[0]), float(trial.t[-1])) if len(trial.t) else (np.nan, np.nan)
            point = {headed(name, POINT_QUANTITIES.get(name, "")): value for name, value in trial.point.items()}
            about = {"repeat": trial.repeat, "reference": trial.reference, "status": trial.status}
            rows.append({"trial": trial.number, **point, **about, "begin [s]": ends[0], "end [s]": ends[1]})
        return pd.DataFrame(rows, columns=None if rows else ["trial"]).set_index("trial")

    def trial(self, number: int) -> pd.DataFrame:
        """Samples of a trial: time [s], channels and flags; UsageError if there is no such trial.

        Of several attempts the finished one is used, which is the last good one, or else the last.
        """
        found = [trial for trial in self.data.trials if trial.number == number]
        found.sort(key=lambda trial: trial.status == "finished")
        if not found:
            numbers = sorted({trial.number for trial in self.data.trials})
            available = f"it has trials {numbers[0]} to {numbers[-1]}" if numbers else "it has none"
            raise UsageError(f"{self.id} has no trial {number}; {available}")
        return _samples(found[-1], self.data)

    @property
    def streams(self) -> list[str]:
        """Names of the streams, for `stream`."""
        from pmabench.store.reader import RunFiles

        return RunFiles(Path(self.data.path)).stream_names()

    def stream(self, name: str = "", *, raw: bool = False) -> pd.DataFrame:
        """A whole stream (by default the first) on the time of the run: time [s], channels and flags.

        With `raw`, the device's clock [ns] and the values as the device gave them. InvalidFile for an unknown name.
        """
        from pmabench.store.reader import read_stream

        frame = read_stream(self.data.path, name, raw=raw)
        units = frame.attrs.get("units", {})
        return frame.rename(columns={c: with_unit(str(c).removesuffix("_ns"), units.get(c, "")) for c in frame.columns})

    @property
    def events(self) -> pd.DataFrame:
        """Commands, trials, findings, prompts: time [s], kind and data of each line of the record."""
        rows = [{"t [s]": event.t, "kind": event.kind, "data": dict(event.data)} for event in self.data.events]
        return pd.DataFrame(rows, columns=["t [s]", "kind", "data"])


def _samples(trial: TrialData, run: RunData) -> pd.DataFrame:
    heads = {name: with_unit(name, run.channels[name].unit if name in run.channels else "") for name in trial.channels}
    columns: dict[str, Any] = {"t [s]": trial.t}
    columns |= {heads[name]: values for name, values in trial.channels.items()}
    return pd.DataFrame(columns | {"flags": trial.flags})


@dataclass(frozen=True)
class Results:
    """Results of runs: one analysis for each kind of test, and the runs."""

    analyses: tuple[Analysis, ...]
    runs: tuple[RunData, ...]

    def to_frame(self) -> pd.DataFrame:
        """One row for each estimate, SI: value, ends of the 95 % interval, unit, operating point, method, trials."""
        return estimates_frame(self.analyses)

    def findings(self) -> pd.DataFrame:
        """Notes, doubts and errors: `level`, `kind`, `text`."""
        rows = [{"level": f.level, "kind": a.kind, "text": f.text} for a in self.analyses for f in a.findings]
        return pd.DataFrame(rows, columns=["level", "kind", "text"])

    def dropped(self) -> pd.DataFrame:
        """Trials that were not used in a fit: `trial`, `kind`, `reason`."""
        rows = [{"trial": d.trial, "kind": a.kind, "reason": d.reason} for a in self.analyses for d in a.dropped]
        return pd.DataFrame(rows, columns=["trial", "kind", "reason"])

    def trace(self, name: str) -> pd.DataFrame:
        """Data of a figure, SI; UsageError with the valid names."""
        traces = {trace.name: trace for analysis in self.analyses for trace in analysis.traces}
        if name not in traces:
            raise UsageError(f'no trace "{name}"; there are: {", ".join(sorted(traces)) or "none"}')
        trace = traces[name]
        return pd.DataFrame({headed(c, trace.quantities.get(c, "")): v for c, v in trace.columns.items()})

    def report(self, path: Path | str, *, title: str | None = None, issuer: Issuer | None = None) -> Path:
        """Write the report as one HTML file; raises UsageError if the runs are of several specimens."""
        from pmabench.kinds.reduce import of_one_specimen
        from pmabench.report.document.content import content_of, write_page

        return write_page(content_of(self.analyses, of_one_specimen(self.runs), title=title, issuer=issuer), Path(path))


def estimates_frame(analyses: Sequence[Analysis]) -> pd.DataFrame:
    """One row for each estimate, SI; the unit of value and interval is in the row, as symbols differ."""
    points = list(dict.fromkeys(name for a in analyses for e in a.estimates for name in e.at))
    rows = []
    for analysis in analyses:
        for e in analysis.estimates:
            low, high = e.ci95 or (np.nan, np.nan)
            row: dict[str, Any] = {"kind": analysis.kind, "symbol": e.symbol, "coordinate": e.coordinate}
            row |= {headed(name, POINT_QUANTITIES.get(name, "")): e.at.get(name, np.nan) for name in points}
            row |= {"value": np.nan if e.value is None else e.value, "low95": low, "high95": high, "unit": e.unit}
            row |= {"n": e.n, "method": e.method, "withheld": e.withheld, "note": e.note, "trials": list(e.trials)}
            rows.append(row | {"simulated": analysis.simulated})
    return pd.DataFrame(rows)


def headed(name: str, quantity: str) -> str:
    """Column name with the SI unit of its quantity."""
    return with_unit(name, QUANTITIES[quantity].unit if quantity in QUANTITIES else "")


def with_unit(name: str, unit: str) -> str:
    """`name [unit]`; the name alone without a unit."""
    return f"{name} [{unit}]" if unit and unit != "1" else name
