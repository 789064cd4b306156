"""A bench looked at without being armed: its devices opened and sampled, nothing commanded, closed on every way out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.bench.interface import CompiledBench, Identity
from pmabench.engine.acquire import Acquisition
from pmabench.engine.own import OwnDevices
from pmabench.engine.recorder import NoRecord
from pmabench.guard.guard import Guard
from pmabench.guard.remote import RemoteGuard

RATE = 100.0
"""Rate at which channels are looked at [Hz]."""


@dataclass(frozen=True)
class Look:
    """An open bench: who answered, and its samples."""

    identities: Mapping[str, Identity]
    acquisition: Acquisition


@contextmanager
def looking(bench: CompiledBench, rate: float = RATE) -> Iterator[Look]:
    """Open the bench and sample it at `rate` [Hz]. Limits are not watched: nothing is armed that could be vented.

    Raises DeviceError where a device does not answer or the bench is in use, LimitRefused where it is tripped.
    """
    clock: RealClock | VirtualClock = RealClock() if bench.realtime else VirtualClock()
    with ExitStack() as stack:
        guard = RemoteGuard(bench, clock) if isinstance(clock, RealClock) else Guard(bench, clock)
        stack.callback(guard.close)
        guard.open()
        identities, streams = dict(guard.identities), dict(guard.devices)
        if bench.realtime:
            own = OwnDevices(bench, clock)
            stack.callback(own.close)
            own.open()
            identities |= own.identities
            streams |= own.streams
        names = tuple(channel.name for channel in bench.channels)
        acquisition = Acquisition(bench, streams, clock, rate, names, NoRecord())
        acquisition.begin_safe_state()
        stack.callback(acquisition.stop)
        acquisition.start()
        yield Look(identities, acquisition)
