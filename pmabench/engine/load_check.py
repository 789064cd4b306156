"""Whether the force of a load at rest is its weight: looked at once after hands put it on, when it hangs still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmabench.base.errors import VerdictFailed
from pmabench.bench.interface import CompiledBench
from pmabench.engine.acquire import Array, Samples, Stop

LIFTED = 1e-3
"""Contraction since the load was put on from which on it hangs [m]."""
STILL = 0.1e-3
"""A load moves by less than this within `SPAN` while it hangs still [m]."""
SPAN = 0.5
"""How long it is looked at [s]."""


class LoadImplausible(VerdictFailed):
    """The load cell and the plates do not agree."""


@dataclass(frozen=True)
class LoadVerdict:
    """What the cell reads of a load at rest, mean over `SPAN` [N]."""

    expected: float
    measured: float
    tolerance: float
    asked: str

    @property
    def ok(self) -> bool:
        """Whether they agree."""
        return abs(self.measured - self.expected) <= self.tolerance

    def __str__(self) -> str:
        """One sentence with the weight of the plates and the reading of the cell."""
        reads = f"the load cell reads {self.measured:.2f} N for a load at rest of {self.expected:.2f} N"
        if self.ok:
            return f"{reads}, within {self.tolerance:.2f} N"
        return (
            f"{reads}, further off than {self.tolerance:.2f} N; asked for was: {self.asked} "
            "Look at the plates that are on, and at the load cell: its plug, its calibration, what touches it"
        )


class LoadCheck:
    """Remembers the load that was put on until it was seen hanging; judges it once."""

    def __init__(self, bench: CompiledBench) -> None:
        channels = {channel.name: channel for channel in bench.channels}
        self._cell = channels.get("force")
        self._possible = bench.free_end == "weights" and self._cell is not None and "displacement" in channels
        self._share = bench.load_tolerance
        self._pending: tuple[float, str, float] | None = None
        self._kept: dict[str, tuple[Array, Array]] = {}

    def put_on(self, force: float, asked: str, displacement: float | None) -> None:
        """Hands put F_L = `force` [N] on, with the free end at `displacement` [m]."""
        self._pending = (force, asked, displacement or 0.0) if self._possible and force > 0 else None
        self._kept = {}

    def watch(self) -> Stop | None:
        """Stop rule for the acquisition while it waits: looks at the samples and never stops."""
        if self._pending is None:
            return None
        self._kept = {}
        return self._keep

    def _keep(self, block: Samples) -> None:
        for name in ("force", "displacement"):
            if name in block.values:
                t, y = self._kept.get(name, (block.t[:0], block.t[:0]))
                t, y = np.concatenate((t, block.t)), np.concatenate((y, block.values[name]))
                recent = t > t[-1] - SPAN
                self._kept[name] = t[recent], y[recent]

    def verdict(self) -> LoadVerdict | None:
        """The verdict when the load has hung still at the end of what was watched, else None."""
        if self._pending is None or len(self._kept) < 2:
            return None
        force, asked, before = self._pending
        (t, x), (_, pull) = self._kept["displacement"], self._kept["force"]
        if len(t) < 5 or t[-1] - t[0] < 0.5 * SPAN or not (np.isfinite(x).all() and np.isfinite(pull).all()):
            return None
        if x.mean() - before < LIFTED or x.max() - x.min() > STILL or self._cell is None:
            return None
        self._pending = None
        known = self._cell.calibration
        tolerance = self._share * force + known.offset_uncertainty + known.gain_uncertainty * force
        return LoadVerdict(force, float(pull.mean()), tolerance, asked)
