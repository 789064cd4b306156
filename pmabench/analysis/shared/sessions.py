"""Which session a test belongs to, and means over sessions: tests of one session are no independent repeats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pmabench.analysis.shared.student import mean_with_half
from pmabench.store.records import Array, RunData

ONE_SESSION = (
    "all tests are of one session, as far as the record tells (its start, the day of a file, its folder): scatter "
    "between sessions is in no interval; tests on another day would show it"
)


def session_of(run: RunData) -> str:
    """The session that a run belongs to.

    That is the session of the bench that the record names; of imports the day, where the file tells it, else the
    folder; else the run by itself.
    """
    session, imported = run.manifest.get("session"), run.manifest.get("imported")
    if isinstance(session, Mapping) and session.get("at"):
        return str(session["at"])
    if isinstance(imported, Mapping):
        known = imported.get("started_known")
        return str(run.manifest.get("started_utc", ""))[:10] if known else str(imported.get("folder", ""))
    return run.id


def by_session(values: Sequence[float] | Array, sessions: Sequence[str]) -> Array:
    """The mean of each session; with one session the values themselves."""
    names = list(dict.fromkeys(sessions))
    if len(names) < 2:
        return np.asarray(values, dtype=np.float64)
    return np.array([np.mean([v for v, s in zip(values, sessions, strict=True) if s == name]) for name in names])


def mean_over_sessions(values: Sequence[float] | Array, sessions: Sequence[str]) -> tuple[float, float | None]:
    """Mean of the sessions' means and its 95 % half width by Student's t over sessions; over values where there is one.

    None in place of the half width where there are fewer than two values.
    """
    return mean_with_half([float(value) for value in by_session(values, sessions)])
