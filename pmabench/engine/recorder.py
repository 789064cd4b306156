"""Recorders of samples and events: the protocol, one that keeps only events, and one whose failure stops nothing.

For a dry run there is one that keeps the peak values and the duration of each trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import RecordError
from pmabench.bench.interface import CompiledBench


class Recorder(Protocol):
    """Takes samples and events: a run folder, or a recorder in memory for a dry run."""

    def append(
        self,
        stream: str,
        time_ns: NDArray[np.int64],
        columns: Mapping[str, Any],
        flags: NDArray[np.uint16],
        host_ns: int | None = None,
    ) -> None:
        """Record raw samples, unscaled; `host_ns` is the arrival of the newest [ns, bench time]."""
        ...

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Record an event at bench time `t` [s]."""
        ...


class NoRecord:
    """A recorder that keeps nothing but the events."""

    def __init__(self) -> None:
        self.events: list[tuple[str, float, dict[str, Any]]] = []

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """Discard the samples."""

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Keep the event in memory."""
        self.events.append((kind, t, data))


class Forgiving:
    """Passes everything to another recorder and keeps its first RecordError in `lost` instead of raising it."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.lost: RecordError | None = None

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """As the other one, while it can."""
        self._attempt(lambda: self._recorder.append(stream, time_ns, columns, flags, host_ns))

    def event(self, kind: str, t: float, **data: Any) -> None:
        """As the other one, while it can."""
        self._attempt(lambda: self._recorder.event(kind, t, **data))

    def _attempt(self, write: Callable[[], None]) -> None:
        try:
            write()
        except RecordError as error:
            self.lost = self.lost or error


@dataclass
class Peak:
    """Peak values and duration of one trial of a dry run."""

    trial: int
    """Its index in the plan."""
    point: dict[str, float]
    highest: dict[str, float] = field(default_factory=dict)
    """Channel -> highest value [SI]."""
    begun: float = 0.0
    duration: float = 0.0
    """[s]"""


class TrialPeaks(NoRecord):
    """A recorder that keeps the peak values of each trial, and no samples."""

    def __init__(self, bench: CompiledBench) -> None:
        super().__init__()
        self.trials: list[Peak] = []
        self._scales = {channel.name: channel.scale for channel in bench.channels}
        self._under_way = False

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """Update the peak values of the current trial."""
        if not self._under_way:
            return
        highest = self.trials[-1].highest
        for name, raw in columns.items():
            if name in self._scales and len(raw):
                top = float(np.nanmax(self._scales[name].to_si(np.asarray(raw, dtype=float))))
                highest[name] = max(highest.get(name, top), top)

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Keep the event, and note begin and end of trials."""
        super().event(kind, t, **data)
        if kind == "trial-begin":
            self.trials.append(Peak(int(data["trial"]), dict(data["point"]), begun=t))
            self._under_way = True
        elif kind == "trial-end" and self.trials:
            self.trials[-1].duration = t - self.trials[-1].begun
            self._under_way = False
