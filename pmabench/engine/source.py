"""One stream with its channels: its clock against bench time, and samples on their way to the recorder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmabench.bench.interface import ChannelRecord, Stream
from pmabench.engine.flags import Spacing

DRIFT = 2e-4
"""How far a device's clock may drift against the computer's [1]."""


class Piece(NamedTuple):
    """Samples as the recorder takes them: all of shape (n,); `host` is when the newest was here [ns, bench time]."""

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Any]
    flags: NDArray[np.uint16]
    host: int | None


class Source:
    """A stream with its clock offset, and the samples that were not handed to the recorder yet."""

    def __init__(self, name: str, stream: Stream, channels: Sequence[ChannelRecord], recorded: Sequence[str]) -> None:
        self.name = name
        self.stream = stream
        self.channels = {channel.name: channel for channel in channels}
        self.recorded = [channel.name for channel in channels if channel.name in recorded]
        self.spacing = Spacing(1.0)
        self.last: int | None = None
        """The newest sample, on the device's clock [ns]."""
        self.heard = 0.0
        """When it came [s]."""
        self.scales = [(channel, channel.scale.slope, channel.scale.offset) for channel in channels]
        self._ahead = inf
        """Bench time minus device time [s]: the least seen, from the sample with the shortest delay."""
        self._rows: list[tuple[int, Mapping[str, Sequence[float]], int, int | None]] = []
        """Single samples: time [ns], raw columns of length 1, flags, arrival [ns].

        The newest ones wait where only the next one shows whether they are late or samples are missing before them.
        """

    def ahead(self, newest: int, arrived: float) -> float:
        """Bench time minus device time [s], after a sample of `newest` [ns] has `arrived` [s]."""
        passed = newest - self.last if self.last is not None else 0
        self._ahead = min(self._ahead + DRIFT * passed * 1e-9, arrived - newest * 1e-9)
        return self._ahead

    def flag(self, flags: Sequence[int]) -> None:
        """Set the flags of the samples that wait (the newest last), now that the next one has decided them."""
        for place, flag in enumerate(flags, len(self._rows) - len(flags)):
            if flag and place >= 0:  # what came before the recording began is not kept
                time_ns, columns, before, arrival = self._rows[place]
                self._rows[place] = time_ns, columns, before | flag, arrival

    def keep(self, time_ns: int, columns: Mapping[str, Sequence[float]], flags: int, host: int | None) -> int:
        """Keep a single sample; how many are kept and can be handed over, 0 while the newest wait."""
        self._rows.append((time_ns, columns, flags, host))
        return 0 if self.spacing.open else len(self._rows)

    def kept(self) -> Iterator[Piece]:
        """The single samples, which are let go; none where there are none."""
        if self._rows:
            rows, self._rows = self._rows, []
            yield Piece(
                np.array([row[0] for row in rows], dtype=np.int64),
                {name: np.array([row[1][name][0] for row in rows]) for name in self.recorded},
                np.array([row[2] for row in rows], dtype=np.uint16),
                rows[-1][3],
            )

    def pieces(
        self, time_ns: NDArray[np.int64], raw: Mapping[str, Any], flags: NDArray[np.uint16], host: int | None
    ) -> Iterator[Piece]:
        """What was kept and then this block, but for the newest samples that wait for the next block."""
        ready = max(0, len(time_ns) - self.spacing.open)
        columns = {name: raw[name] for name in self.recorded}
        if ready == len(time_ns):
            yield from self.kept()
            yield Piece(time_ns, columns, flags, host)
            return
        if ready:
            yield from self.kept()
            yield Piece(
                time_ns[:ready], {name: column[:ready] for name, column in columns.items()}, flags[:ready], None
            )
        for i in range(ready, len(time_ns)):
            one = {name: column[i : i + 1] for name, column in columns.items()}
            self.keep(int(time_ns[i]), one, int(flags[i]), host)
