"""Zeros: taken under their rules, applied to a bench as another offset; the calibration is unchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from pmabench.base.errors import VerdictFailed
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.compile import Mounted
from pmabench.bench.files.bench import PLACED
from pmabench.bench.interface import CompiledBench, Scale
from pmabench.bench.session import Zero
from pmabench.engine.executor import Executor
from pmabench.protocol.plan import Ask, Set, WaitUntil
from pmabench.session.guided import load_text, moving_mass
from pmabench.session.listening import Reading, steady

PHASE = "zeros"
DRIFT = 0.2
"""Most drift while a zero is taken, of its limit."""
STEADY = 1.0
"""Over what time a zero is the mean [s]."""
STEADY_WITHIN = 30.0
"""How long a channel may take to come to rest [s]."""


@dataclass(frozen=True)
class ZeroTaken:
    """Reading of a channel at its zero [SI], on the scale of its calibration."""

    value: float
    noise: float
    limit: float
    condition: str


class ZeroRefused(VerdictFailed):
    """A zero has moved more than its limit since the calibration."""


def take_zeros(executor: Executor, mounted: Mounted) -> dict[str, ZeroTaken]:
    """The zeros that the bench's session asks for, in the order of their rules.

    The pressure is zeroed vented, with the valves open; the force unloaded, as the operator says; displacement and
    angle at their stated references. Raises ZeroRefused, or VerdictFailed where a channel does not come to rest.
    """
    wanted = mounted.session.zeros if mounted.session is not None else {}
    taken: dict[str, ZeroTaken] = {}
    _vent(executor)
    if "pressure" in wanted:
        executor.guard.valves(closed=False)
        taken["pressure"] = _take(executor, "pressure", wanted["pressure"], "vented, valves open")
        executor.guard.valves(closed=True)
    if "force" in wanted:
        text = load_text(mounted, 0.0)
        executor.do(Ask(PHASE, text, "vented", (0.0, moving_mass(mounted, 0.0))))
        taken["force"] = _take(executor, "force", wanted["force"], "unloaded")
    for name in (name for name in PLACED if name in wanted):
        zero, load = wanted[name], None
        text = f"Bring the free end to where its {name} is zero: {zero.at}."
        if zero.load is not None:
            load = (zero.load * mounted.bench.gravity, moving_mass(mounted, zero.load))
            text = f"{load_text(mounted, zero.load)} {text}"
        executor.do(Ask(PHASE, text, "vented", load))
        taken[name] = _take(executor, name, zero, zero.at)
    return taken


def _vent(executor: Executor) -> None:
    """Every output at its safe value, the pressure gone."""
    for output in executor.bench.outputs:
        executor.do(Set(PHASE, output.name, output.safe))
    if any(channel.name == "pressure" for channel in executor.bench.channels):
        executor.do(WaitUntil(PHASE, "pressure", "below", executor.bench.hands_below, 0.1, STEADY_WITHIN, "flag"))


def _take(executor: Executor, name: str, zero: Zero, condition: str) -> ZeroTaken:
    reading: Reading = steady(executor.acquisition, name, DRIFT * zero.most, seconds=STEADY, within=STEADY_WITHIN)
    quantity = CHANNEL_QUANTITY[name]
    if abs(reading.mean) > zero.most:
        channel = next(c for c in executor.bench.channels if c.name == name)
        calibration = f"calibration {channel.calibration.id}" if channel.calibration.id else "the bench file"
        raise ZeroRefused(
            f"the zero of {name} is refused: {condition} it reads {show(reading.mean, quantity, 4)}, more than "
            f"{show(zero.most, quantity, 4)} away from {calibration}; look at the sensor and its mounting, "
            "then calibrate it"
        )
    return ZeroTaken(reading.mean, reading.noise, zero.most, condition)


def with_zeros(mounted: Mounted, zeros: Mapping[str, float], about: Mapping[str, Any] | None) -> Mounted:
    """The bench with zeros [SI] taken off the offsets of its channels; `about` is what manifests say of the session."""
    devices = tuple(
        replace(
            device,
            channels=tuple(
                replace(
                    channel,
                    scale=Scale(channel.scale.slope, channel.scale.offset - zeros[channel.name]),
                    zero=zeros[channel.name],
                )
                if channel.name in zeros and channel.zero is None
                else channel
                for channel in device.channels
            ),
        )
        for device in mounted.bench.devices
    )
    bench: CompiledBench = replace(mounted.bench, devices=devices)
    return replace(mounted, bench=bench, in_session=about)


def as_data(taken: Mapping[str, ZeroTaken]) -> dict[str, dict[str, Any]]:
    """Plain data for records and state."""
    return {name: asdict(zero) for name, zero in taken.items()}
