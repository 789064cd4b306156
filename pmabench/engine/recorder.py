"""Where samples and events go: a run folder, or nowhere; and a recorder whose failure stops nothing.

A plan that is only tried leaves what each trial comes to: highest contraction and force, and how long it takes.
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
    """Where samples and events go: a run folder, or nowhere when a plan is only tried."""

    def append(
        self,
        stream: str,
        time_ns: NDArray[np.int64],
        columns: Mapping[str, Any],
        flags: NDArray[np.uint16],
        host_ns: int | None = None,
    ) -> None:
        """Samples as the device gave them; `host_ns` is when the newest was here [ns, bench time]."""
        ...

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Something that happened at bench time `t` [s]."""
        ...


class NoRecord:
    """A recorder that keeps nothing but the events."""

    def __init__(self) -> None:
        self.events: list[tuple[str, float, dict[str, Any]]] = []

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """Nothing is kept."""

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Kept in memory."""
        self.events.append((kind, t, data))


class Forgiving:
    """Passes everything to another recorder; when that fails, notes it once and goes on without it."""

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
    """One trial."""

    trial: int
    """Its index in the plan."""
    point: dict[str, float]
    highest: dict[str, float] = field(default_factory=dict)
    """Channel -> highest value [SI]."""
    begun: float = 0.0
    duration: float = 0.0
    """[s]"""


class TrialPeaks(NoRecord):
    """A recorder that keeps the peaks of trials, and no samples."""

    def __init__(self, bench: CompiledBench) -> None:
        super().__init__()
        self.trials: list[Peak] = []
        self._scales = {channel.name: channel.scale for channel in bench.channels}
        self._under_way = False

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """Look at the samples of the trial that is under way."""
        if not self._under_way:
            return
        highest = self.trials[-1].highest
        for name, raw in columns.items():
            if name in self._scales and len(raw):
                top = float(np.nanmax(self._scales[name].to_si(np.asarray(raw, dtype=float))))
                highest[name] = max(highest.get(name, top), top)

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Begin and end of trials; all is kept as usual."""
        super().event(kind, t, **data)
        if kind == "trial-begin":
            self.trials.append(Peak(int(data["trial"]), dict(data["point"]), begun=t))
            self._under_way = True
        elif kind == "trial-end" and self.trials:
            self.trials[-1].duration = t - self.trials[-1].begun
            self._under_way = False
