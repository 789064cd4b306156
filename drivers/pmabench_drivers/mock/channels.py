"""The channels of the mock bench: noise, counts, and what may be wrong with a sensor; knows no plant, no link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.bench.interface import Block, ChannelRecord
from pmabench.model.motion import NoiseSource
from pmabench_drivers.mock.options import ACCELERATIONS, INPUTS, SENSORS, Faults, SensorError

GAP = 0.02
NO_FAULTS = Faults()
Column = list[float] | NDArray[Any]


class Channel:
    """One channel: its noise, and the way from SI to what the device gives."""

    def __init__(self, record: ChannelRecord, sigma: float, seed: int) -> None:
        self.record = record
        self.counts = record.raw_type == "int32"
        self._sigma = sigma
        self._noise = NoiseSource(seed, INPUTS.index(record.input))
        self.scale = record.calibrated
        self.ends = float(self.scale.to_raw(record.low)), float(self.scale.to_raw(record.high))
        self.low, self.high = round(min(self.ends)), round(max(self.ends))

    def raw(self, si: NDArray[np.float64], first: int) -> Column:
        """Device units of consecutive samples in SI, the first of which has the number `first`."""
        raw = self._noise.samples(first, len(si)) if self._sigma else np.zeros(len(si))
        raw *= self._sigma
        raw += si
        raw -= self.scale.offset
        raw /= self.scale.slope
        return self._given(raw)

    def raw_one(self, si: float, number: int) -> float:
        """The same for one sample."""
        if self._sigma:
            si += self._sigma * self._noise.one(number)
        raw = self.scale.to_raw(si)
        return min(max(round(raw), self.low), self.high) if self.counts else float(raw)

    def wrong(self, raw: NDArray[Any], error: SensorError) -> NDArray[Any]:
        """What the device gives instead of `raw` when its sensor has that error."""
        if error.end:
            return np.full(raw.shape, self._given(np.array(self.ends[error.end == "high"])), dtype=raw.dtype)
        scale = self.scale
        return self._given(scale.to_raw(error.factor * scale.to_si(raw) + error.offset))

    def _given(self, raw: Any) -> NDArray[Any]:
        if not self.counts:
            return np.asarray(raw, dtype=np.float64)
        return np.asarray(np.clip(np.rint(raw), self.low, self.high), dtype=np.int32)


class Damage:
    """What is done to blocks that the channels gave: wrong readings, lost samples.

    `pressure` is the input that gets stuck.
    `stuck` has the values that stuck channels repeat [device units], by input; a new one whenever one is added.
    """

    def __init__(self, channels: Sequence[Channel], pressure: str = "pressure") -> None:
        self._channels, self._pressure = channels, pressure
        self._by_input = {channel.record.input: channel for channel in channels}
        self.stuck: dict[str, float] = {}
        self._seen, self._none = NO_FAULTS, True

    def done(self, block: Block, faults: Faults, errors: Mapping[str, SensorError]) -> Block:
        """The block as it arrives; `faults` and `errors` are those of this moment."""
        if faults is not self._seen:
            self._seen, self._none = faults, faults == NO_FAULTS
        if self._none and not errors:
            return block
        time = np.asarray(block.time, dtype=np.int64)
        columns = {name: np.array(column) for name, column in block.columns.items()}
        seconds = time / 1e9
        self._errors(columns, seconds, errors)
        for channel in self._channels:
            column = columns[channel.record.name]
            since = self._stuck_since(channel.record.input, faults)
            if since is not None and (stuck := seconds >= since).any():
                self.stuck = {channel.record.input: float(column[stuck.argmax()])} | self.stuck
                column[stuck] = self.stuck[channel.record.input]
            if faults.nan_at is not None and channel.record.input in SENSORS:
                column[seconds >= faults.nan_at] = channel.low if channel.counts else np.nan
        if faults.gap_at is not None:
            kept = (seconds < faults.gap_at) | (seconds >= faults.gap_at + GAP)
            time, columns = time[kept], {name: column[kept] for name, column in columns.items()}
        return as_block(time, columns)

    def _stuck_since(self, name: str, faults: Faults) -> float | None:
        return faults.accelerometer_frozen_at if name in ACCELERATIONS else (
            faults.pressure_stuck_at if name == self._pressure else None
        )  # fmt: skip

    def _errors(
        self, columns: dict[str, NDArray[Any]], seconds: NDArray[np.float64], errors: Mapping[str, SensorError]
    ) -> None:
        own = dict(columns)
        for channel in self._channels:
            error = errors.get(channel.record.input)
            if error is None:
                continue
            raw = own[channel.record.name]
            if error.reads:
                raw = np.asarray(own[self._by_input[error.reads].record.name])
            columns[channel.record.name] = np.where(
                seconds >= error.at, channel.wrong(raw, error), own[channel.record.name]
            )


def as_block(time: Any, columns: Mapping[str, Any]) -> Block:
    """A block of lists or arrays."""
    return Block(time, columns)
