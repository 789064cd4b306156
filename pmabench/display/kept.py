"""Samples as far as curves and the lines of trials need them, by stream; knows no files."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from pmabench.display.follow import Block
from pmabench.store.records import Array, Flags
from pmabench.store.timebase import onto


class Kept:
    """Blocks of samples in the order in which they came."""

    def __init__(self) -> None:
        self._blocks: dict[str, deque[Block]] = {}

    def add(self, stream: str, block: Block) -> None:
        """Keep a block, which is not empty."""
        self._blocks.setdefault(stream, deque()).append(block)

    def forget(self, before: float) -> None:
        """Let go of blocks that end before a time [s], but the last of each stream."""
        for blocks in self._blocks.values():
            while len(blocks) > 1 and blocks[0].t[-1] < before:
                blocks.popleft()

    @property
    def newest(self) -> float:
        """Time of the newest sample [s]; 0 where there is none."""
        return max((float(blocks[-1].t[-1]) for blocks in self._blocks.values()), default=0.0)

    @property
    def reached(self) -> float:
        """Time up to which every stream was read [s]."""
        return min((float(blocks[-1].t[-1]) for blocks in self._blocks.values()), default=-np.inf)

    def trace(self, channel: str) -> tuple[Array, Array]:
        """Time [s] and value [SI] of a channel, both of shape (n,)."""
        for blocks in self._blocks.values():
            if channel in blocks[-1].values:
                return np.concatenate([b.t for b in blocks]), np.concatenate([b.values[channel] for b in blocks])
        return np.empty(0), np.empty(0)

    def between(
        self, begin: float, end: float, rates: Mapping[str, float]
    ) -> tuple[Array, dict[str, Array], Flags, float]:
        """Times [s], channels [SI], flags and rate [Hz], about from `begin` to `end` [s].

        On the times of the stream with the displacement, else the pressure, as `open_run` has them.
        """
        parts: dict[str, tuple[Array, dict[str, Array], Flags]] = {}
        for name, blocks in self._blocks.items():
            near = [b for b in blocks if b.t[-1] >= begin - 1.0 and b.t[0] <= end + 1.0]
            if near:
                columns = {c: np.concatenate([b.values[c] for b in near]) for c in near[0].values}
                parts[name] = np.concatenate([b.t for b in near]), columns, np.concatenate([b.flags for b in near])
        if not parts:
            return np.empty(0), {}, np.empty(0, np.uint16), 0.0
        named = (n for channel in ("displacement", "pressure") for n in parts if channel in parts[n][1])
        main = next(named, next(iter(parts)))
        t, channels, flags = parts[main]
        for name, (other, columns, other_flags) in parts.items():
            missing = {c: values for c, values in columns.items() if c not in channels}
            if name != main and missing:
                moved, flags, _ = onto(t, flags, other, other_flags, missing, rates.get(name, 0.0))
                channels |= moved
        return t, channels, flags, rates.get(main, 0.0)
