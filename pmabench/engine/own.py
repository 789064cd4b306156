"""Devices that only measure: the engine opens them itself, each called from its own thread with a deadline."""

from __future__ import annotations

from contextlib import suppress
from functools import partial

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, CompiledBench, Device, Identity, Stream
from pmabench.guard.links import OPENS_WITHIN, load_driver
from pmabench.guard.owner import Owner

COLLECTS_WITHIN = 0.5
"""How long handing over samples may take [s]."""


class OwnStream:
    """A stream behind its owner."""

    def __init__(self, owner: Owner, device: Stream) -> None:
        self._owner, self._device = owner, device

    def start(self, rate: float) -> float:
        """As `Stream.start`."""
        return float(self._owner.call(partial(self._device.start, rate), COLLECTS_WITHIN))

    def stop(self) -> None:
        """As `Stream.stop`."""
        self._owner.call(self._device.stop, COLLECTS_WITHIN)

    def collect(self) -> Block:
        """As `Stream.collect`."""
        block: Block = self._owner.call(self._device.collect, COLLECTS_WITHIN)
        return block


class OwnDevices:
    """The devices of a bench that carry no output; none in virtual time, where the guard has all."""

    def __init__(self, bench: CompiledBench, clock: Clock) -> None:
        self._records = [record for record in bench.devices if bench.realtime and not record.guarded]
        self._clock = clock
        self._opened: dict[str, tuple[Owner, Device]] = {}
        self.identities: dict[str, Identity] = {}
        self.streams: dict[str, OwnStream] = {}
        self.channels = frozenset(channel.name for record in self._records for channel in record.channels)

    def open(self) -> None:
        """Open all; on failure those already open are closed."""
        for record in self._records:
            owner = Owner(record.name)
            try:
                device = load_driver(record, self._clock)
                self.identities[record.name] = owner.call(device.open, OPENS_WITHIN)
            except BaseException:
                self.close()
                raise
            self._opened[record.name] = owner, device
            if isinstance(device, Stream):
                self.streams[record.name] = OwnStream(owner, device)

    def close(self) -> None:
        """Let go of all; harmless when repeated."""
        for owner, device in self._opened.values():
            with suppress(DeviceError):
                owner.call(device.close)
        self._opened = {}
