"""What each trial of a run that is only tried comes to: highest contraction and force, and how long it takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.bench.interface import CompiledBench
from pmabench.engine.recorder import NoRecord


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
