"""The safe state without a guard process: for when there is none, or it does not answer."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from pmabench.base.clock import RealClock
from pmabench.base.errors import PmaError, RecordError
from pmabench.bench.interface import CompiledBench, Stream
from pmabench.guard.guard import Guard, State
from pmabench.guard.safe import Vent
from pmabench.guard.station import UNCLEAN, Station

RATE = 50.0
"""At which the pressure is looked at while a vent is confirmed [Hz]."""


def vent_directly(bench: CompiledBench, station: Station, why: str) -> Vent:
    """Open the guarded devices here, run the safe state, write its result into the bench's state folder.

    Devices that cannot be opened are left out: those that answer are vented. A bench that was armed or tripped before,
    or is not confirmed to be safe now, is latched.
    """
    guard = Guard(bench, RealClock(), threads=True, forgiving=True)
    guard.open()
    try:
        sampled = [name for name, device in list(guard.devices.items()) if isinstance(device, Stream)]
        guard.begin_safe()
        guard.step_safe({})
        for name in sampled:
            with suppress(PmaError):
                guard.links.stream(name, RATE)

        def measure() -> Mapping[str, float]:
            guard.latest.clear()
            guard.clock.wait_until(guard.clock.now() + 0.05)
            for name in sampled:
                with suppress(PmaError):
                    guard.collect(name)
            return guard.latest

        vent = guard.safe_state(measure)
    finally:
        guard.close()
    unclean = station.read("state").get("what") == "armed"
    latched = bool(station.latched()) or not vent.confirmed or guard.state is State.TRIPPED
    why = UNCLEAN if unclean else why
    if not vent.confirmed:
        why = f"{why}; safe state {vent.result}"
    with suppress(RecordError):
        station.note("tripped" if latched else "safe", why=why, vent=vars(vent))
    return vent
