"""Checks of a bench before and during a run: its drivers, its vent path, and the weight of a load at rest.

- Drivers that nobody has tried on hardware: the operator is asked once for each bench, and the run records it.
- The proof test of the vent path: fill to a low pressure, vent, check the pressure; before any other command.
- The load: checked once after it was put on by hand, when it hangs still.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, nan
from typing import TYPE_CHECKING

import numpy as np

from pmabench.base.errors import DeviceError, LimitTripped, PmaError
from pmabench.base.quantities import show
from pmabench.bench.driver_options import HARDWARE, driver_version
from pmabench.bench.interface import UNPROVEN, CompiledBench, DeviceRecord, Identity, ProofTest
from pmabench.engine.acquire import Acquisition, Array, Samples, Stop
from pmabench.engine.recorder import Recorder
from pmabench.guard.owner import PATIENCE
from pmabench.guard.remote import AnyGuard
from pmabench.guard.station import Station

if TYPE_CHECKING:
    from pmabench.engine.executor import Executor

AGREED = "drivers"
"""File in the bench's state folder: the drivers that somebody agreed to, by driver and version."""


def as_data(bench: CompiledBench) -> dict[str, dict[str, str]]:
    """Entry of the manifest: each device's driver, its version and what it was verified on."""
    return {
        one.name: {"driver": one.driver, "version": driver_version(one.driver), "verified": one.verified}
        for one in bench.devices
    }


def doubt(device: DeviceRecord, identity: Identity) -> str:
    """Why the driver is not verified for this real device; empty where it is verified, or the device is simulated."""
    if identity.simulated:
        return ""
    if not device.verified.startswith(HARDWARE):
        return f"was never tried on a device (verified: {device.verified})"
    if device.verified_firmware and device.verified_firmware != identity.firmware:
        return f"is {device.verified}, and firmware {identity.firmware or 'unknown'} answers"
    return ""


def not_proven(identities: Mapping[str, Identity]) -> list[str]:
    """Emulated devices with wiring and scales taken from the bench file: errors of that file stay invisible."""
    return [name for name, identity in identities.items() if identity.model.startswith(UNPROVEN)]


def refuse_twice(bench: CompiledBench, identities: Mapping[str, Identity]) -> None:
    """Raise DeviceError where one device answers under two names: the vent of the other could not be verified."""
    seen: dict[tuple[str, str, str], str] = {}
    for name, one in identities.items():
        who = one.maker, one.model, one.serial
        if one.serial and not one.simulated and (first := seen.setdefault(who, name)) != name:
            shown = f"{one.maker} {one.model}, serial number {one.serial}"
            raise DeviceError(
                bench.name, f"{first} and {name} are the same device, {shown}: correct one of the addresses"
            )


def refuse_other_zeros(bench: CompiledBench, zeroed: Mapping[str, str], identities: Mapping[str, Identity]) -> None:
    """Raise DeviceError where a channel's zero was taken with another device.

    `zeroed`: device name -> serial number at the time of the zeros.
    """
    for device in bench.devices:
        then, now = zeroed.get(device.name, ""), identities[device.name].serial
        if then and now != then and any(channel.zero is not None for channel in device.channels):
            text = f"has the serial number {now or 'unknown'}, and the zeros of the session were taken with {then}"
            raise DeviceError(device.name, f"{text}: hold the session again with --new-session")


def agree(executor: Executor, identities: Mapping[str, Identity]) -> None:
    """Ask once per bench, driver, version and doubt, before anything is armed; a person's answer is stored."""
    station = Station(executor.bench.name)
    for device in executor.bench.devices:
        identity = identities[device.name]
        why = doubt(device, identity)
        if not why:
            continue
        key = f"{device.driver} {driver_version(device.driver)} {why}"
        agreed = station.read(AGREED)
        if key not in agreed:
            answer = _ask(executor, device, identity, why)
            if "--yes" not in answer:
                at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
                with suppress(PmaError):  # if it cannot be stored, it is asked again
                    station.write(AGREED, {**agreed, key: {"answer": answer, "at": at}})


def _ask(executor: Executor, device: DeviceRecord, identity: Identity, why: str) -> str:
    who = " ".join(part for part in (identity.maker, identity.model) if part)
    text = (
        f"The driver of {device.name} ({who}), {device.driver}, {why}. Trust no value and no vent before you have "
        "compared it with an instrument. This is asked once."
    )
    answer = executor.prompt(text, phase="driver", device=device.name)
    executor.event("answer", text=text, phase="driver", device=device.name, answer=answer)
    return answer


QUESTIONS, SIGNS = 3, 8
"""Answer times that a command takes (after a pending question, with read-back), and that a watchdog must allow [1]."""
NEARLY, SAMPLES = 0.99, 0.7
"""Share of the requested rate that is accepted as reached, and share of the possible rate that is recommended [1]."""
APART, SPARE = 3.0, 0.1
"""A lost or delayed answer may leave no sample for this many periods [1] plus this time [s]."""


def refuse_slow(
    bench: CompiledBench, identities: Mapping[str, Identity], wanted: float, used: Mapping[str, float]
) -> None:
    """Raise DeviceError where a device answers too slowly for its rate, commands, watchdog or `stale` limits.

    `wanted`: rate of the plan; `used`: device name -> actual rate [Hz].
    """
    for device in bench.devices:
        takes, most = identities[device.name].answers, min(wanted, device.fastest or wanted)
        rate, signs = used.get(device.name, most), SIGNS * takes
        wrong = ""
        if takes and rate < NEARLY * most:
            can = f"{floor(10 * SAMPLES * rate) / 10:g}"
            wrong = (
                f"next to the guard's questions it can be read {rate:.3g} times a second, and {most:g} Hz are asked; "
                f"declare rate: {can} Hz{f' ({device.fastest_from})' if device.fastest_from else ''}, or have fewer of "
                "its inputs as channels, or"
            )
        elif device.guarded and QUESTIONS * takes > PATIENCE:
            longest = f"{1e3 * QUESTIONS * takes:.0f} ms"
            wrong = f"a command that is read back may take {longest}, and the guard waits {1e3 * PATIENCE:.0f} ms;"
        elif 0 < device.watchdog < signs:
            wrong = f"its watchdog may hear nothing for {signs:.2g} s; declare watchdog: {1.2 * signs:.2g} s, or"
        elif takes:
            wrong = _too_strict(bench, device, rate)
        if wrong:
            raise DeviceError(
                device.name, f"takes {1e3 * takes:.0f} ms for an answer: {wrong} use a quicker line (baud)"
            )


def _too_strict(bench: CompiledBench, device: DeviceRecord, rate: float) -> str:
    """What is wrong where one lost answer at `rate` [Hz] would exceed a `stale` limit; empty where none would."""
    own, apart = {channel.name for channel in device.channels}, APART / rate + SPARE
    for trip in bench.trips:
        if trip.kind == "stale" and trip.channel in own and trip.delay < apart * (1 - 1e-9):
            return (
                f"at {rate:.3g} Hz there may be no sample for {apart:.2g} s, and the bench trips after {trip.delay:g} "
                f"s ({trip.source}); declare {{stale: {trip.channel}, for: {ceil(100 * apart) * 10} ms}}, ask for a "
                "higher rate where the line allows it, or"
            )
    return ""


ARRIVES = 0.5
"""Time within which a drive that moves to its safe position must come nearer [s] ..."""
NEARER = 0.1
"""... by at least this share of the deviation that its `following` limit allows."""


def await_drives(bench: CompiledBench, acquisition: Acquisition) -> None:
    """Wait until each drive with a `following` limit is measured at its safe position, where arming sent it.

    Raises LimitTripped where it is elsewhere and comes no nearer: a drive that lost its zero reports that it has
    arrived.
    """
    drives = {output.name: output for output in bench.outputs if output.rate}
    for trip in bench.trips:
        if trip.kind != "following" or trip.channel not in drives or trip.high is None:
            continue
        output, before = drives[trip.channel], None
        while not (off := abs(acquisition.latest.get(output.name, nan) - output.safe)) <= trip.high:
            if before is not None and not off < before - NEARER * trip.high:
                at, sent = (show(v, output.quantity) for v in (acquisition.latest.get(output.name, nan), output.safe))
                raise LimitTripped(
                    f"the drive of {output.device} was sent to {sent}, and {output.name} stays at {at}, further than "
                    f"{show(trip.high, output.quantity)} ({trip.source}): it lost its zero, counts otherwise than the "
                    "sensor, or does not move; find its zero again (homing)"
                )
            before = off
            acquisition.pass_time(ARRIVES)


FILLED = 0.8
"""Share of the commanded pressure from which on the bench counts as filled."""
RESTS = 0.2
"""Time for which the pressure must stay within its bounds [s]."""
OFF = 0.1, 0.01
"""Largest deviation of a resting pressure from its command, as shares of the command and of the regulator's range [1],
for gains and offsets of gauge and regulator."""
GIVES_WAY = 0.1
"""Relative fall of the pressure that an open dump valve must cause while the regulator still commands it."""
ALONE = 1.0
"""Largest time until that fall [s]."""


def prove(bench: CompiledBench, guard: AnyGuard, acquisition: Acquisition, recorder: Recorder) -> None:
    """Do the proof test of the vent path where the bench declares one; LimitTripped if it does not vent in time."""
    proof = bench.proof
    if proof is None:
        return
    clock = acquisition.clock
    names = [output.name for output in bench.pressures]
    asked = clock.now()
    for name in names:
        guard.set(name, proof.pressure)
        acquisition.commanded.set(name, asked, proof.pressure)
    filled = acquisition.pass_time(proof.fill, _crossing(names, above=FILLED * proof.pressure))
    if filled is None:
        measured = _measured(acquisition, names)
        raise LimitTripped(
            f"the proof test asked for {show(proof.pressure, 'pressure')}, and after {proof.fill:g} s {measured} is "
            "measured: no supply, a shut valve, a dump valve that stays open (its plug, its pilot air, its "
            '"energised"), or the pressure channel is wired wrongly'
        )
    _refuse_astray(bench, acquisition, proof, filled - asked)
    alone = _valves_alone(bench, guard, acquisition, proof)
    vented_at = clock.now()
    for output in bench.pressures:
        guard.set(output.name, output.safe)
        acquisition.commanded.set(output.name, vented_at, output.safe)  # so that the fall is no burst
    guard.valves(closed=False)
    vented = acquisition.pass_time(proof.within, _crossing(names, below=proof.below))
    if vented is None:
        measured = _measured(acquisition, names)
        raise LimitTripped(
            f"the vent path failed its proof test: {measured} {proof.within:g} s after venting, "
            f"below {show(proof.below, 'pressure')} was expected; look at the dump valve and at the regulator's exhaust"
        )
    guard.valves(closed=True)
    guard.release()
    times = {"filled_in": filled - asked, "vented_in": vented - vented_at}
    recorder.event("proof-test", clock.now(), pressure=proof.pressure, dump_valve_in=alone, **times)


def _refuse_astray(bench: CompiledBench, acquisition: Acquisition, proof: ProofTest, filled_in: float) -> None:
    """Raise LimitTripped where a pressure does not settle near its command, above or below."""
    channels = {channel.name: channel for channel in bench.channels}
    within = {
        output.name: OFF[0] * proof.pressure
        + OFF[1] * output.high
        + channels[output.name].calibration.uncertainty(proof.pressure)
        for output in bench.pressures
    }
    bounds = {name: (proof.pressure - off, proof.pressure + off) for name, off in within.items()}
    if acquisition.pass_time(max(1.0, proof.fill - filled_in), _Resting(bounds)) is None:
        raise LimitTripped(
            f"the proof test asked for {show(proof.pressure, 'pressure')}, and {_measured(acquisition, list(within))} "
            f"is measured, further off than {show(max(within.values()), 'pressure', 2)}: the scale of the regulator or "
            "of the gauge is wrong, or the gauge reads absolute pressure"
        )


class _Resting:
    """Stop rule: all channels have been within their bounds for `RESTS`."""

    def __init__(self, bounds: Mapping[str, tuple[float, float]]) -> None:
        self._bounds = bounds
        self._since: dict[str, float] = {}

    def __call__(self, block: Samples) -> int | None:
        for name in self._bounds.keys() & block.values.keys():
            low, high = self._bounds[name]
            inside = (block.values[name] > low) & (block.values[name] < high)
            if not inside[-1]:
                self._since.pop(name, None)
            elif name not in self._since or not inside.all():
                self._since[name] = float(block.t[np.flatnonzero(np.append(False, inside[:-1]) < inside)[-1]])
        newest = float(block.t[-1])
        rests = all(name in self._since and newest - self._since[name] >= RESTS for name in self._bounds)
        return len(block.t) - 1 if rests else None


def _valves_alone(bench: CompiledBench, guard: AnyGuard, acquisition: Acquisition, proof: ProofTest) -> float | None:
    """Open the dump valves while the regulators still command the pressure; returns the time until it falls [s].

    None where the bench has no dump valve, or fewer than muscles and not all gave way. Raises LimitTripped where one
    that has its own did not, or none did: a valve that is not connected passes every vent of a regulator that works.
    """
    valves = [valve.name for valve in bench.valves if valve.safe == "open"]
    if not valves:
        return None
    names, opened_at = [output.name for output in bench.pressures], acquisition.clock.now()
    for output in bench.pressures:
        acquisition.commanded.set(output.name, opened_at, output.safe)  # it falls as commanded: no burst
    guard.valves(closed=False)
    below = (1 - GIVES_WAY) * proof.pressure
    found = acquisition.pass_time(ALONE, _crossing(names, below=below))
    gave = [name for name in names if acquisition.latest.get(name, nan) < below]
    if found is None and len(gave) < (len(names) if len(valves) >= len(names) else 1):
        raise LimitTripped(
            f"the proof test of {' and '.join(valves)} failed: {ALONE:g} s after it was opened "
            f"{_measured(acquisition, names)} is measured, while the regulator still commands "
            f"{show(proof.pressure, 'pressure')}: look at the valve's plug, its air, and at what is in its way. "
            "The gauge must be on the muscle's side of the valve"
        )
    return None if found is None else found - opened_at


def _measured(acquisition: Acquisition, names: Sequence[str]) -> str:
    """The newest pressure of each muscle, in words."""
    return " and ".join(show(acquisition.latest.get(name, float("nan")), "pressure") for name in names)


def _crossing(names: Sequence[str], above: float = float("-inf"), below: float = float("inf")) -> Stop:
    """Stop rule: the sample at which the last of these channels has come between the bounds."""
    left = set(names)

    def crossed(block: Samples) -> int | None:
        last = None
        for name in left & block.values.keys():
            inside = (block.values[name] > above) & (block.values[name] < below)
            if inside.any():
                left.discard(name)
                last = max(last or 0, int(inside.argmax()))
        return last if not left else None

    return crossed


LIFTED = 1e-3
"""Contraction since the load was put on from which on it hangs freely [m]."""
STILL = 0.1e-3
"""A load moves by less than this within `SPAN` while it hangs still [m]."""
SPAN = 0.5
"""Time over which the load is observed [s]."""


GROSS = 0.5
"""Relative deviation of a reading from the load above which unit, sign or plug must be wrong [1]."""
UNDER_PRESSURE = 100e3
"""Rise of the pressure since the load was put on at which a muscle must contract [Pa]."""


class LoadImplausible(PmaError):
    """Raised where load cell and plates do not agree, or the free end moves the wrong way: trials are left undone."""

    exit_code = 4


@dataclass(frozen=True)
class LoadVerdict:
    """Reading of the load cell for a load at rest, mean over `SPAN` [N], and contraction since it was put on [m]."""

    expected: float
    measured: float
    tolerance: float
    asked: str
    contraction: float

    @property
    def ok(self) -> bool:
        """Whether reading and weight agree within the tolerance, and the muscle did not extend under pressure."""
        return self.contraction > 0 and abs(self.measured - self.expected) <= self.tolerance

    @property
    def gross(self) -> bool:
        """Whether sign, unit or plug of a channel must be wrong, whatever the tolerance."""
        return self.contraction < 0 or abs(self.measured - self.expected) > max(self.tolerance, GROSS * self.expected)

    def __str__(self) -> str:
        """One sentence with the weight of the plates and the reading of the cell."""
        if self.contraction < 0:
            return (
                f"under pressure the displacement falls by {show(-self.contraction, 'length', 3)}: its channel counts "
                "backwards, or is exchanged with another one; look at its calibration and its plug"
            )
        reads = f"the load cell reads {self.measured:.2f} N for a load at rest of {self.expected:.2f} N"
        if self.ok:
            return f"{reads}, within {self.tolerance:.2f} N"
        return (
            f"{reads}, further off than {self.tolerance:.2f} N; asked for was: {self.asked} "
            "Look at the plates that are on, and at the load cell: its plug, its calibration, what touches it"
        )


class LoadCheck:
    """Keeps the load that was put on until it hangs still, then compares it once with the load cell."""

    def __init__(self, bench: CompiledBench) -> None:
        channels = {channel.name: channel for channel in bench.channels}
        self._cell = channels.get("force")
        self._possible = bench.free_end == "weights" and self._cell is not None and "displacement" in channels
        self._share = bench.load_tolerance
        self._pending: tuple[float, str, float, float] | None = None
        self._kept: dict[str, tuple[Array, Array]] = {}

    def put_on(self, force: float, asked: str, latest: Mapping[str, float]) -> None:
        """Note that a load of `force` [N] was put on by hand; `latest` are the values measured then [SI]."""
        place, P = (latest.get(name, 0.0) for name in ("displacement", "pressure"))
        self._pending = (force, asked, place, P) if self._possible and force > 0 else None
        self._kept = {}

    def watch(self) -> Stop | None:
        """Stop rule that keeps the samples of a wait and never stops; None where no load is to be checked."""
        if self._pending is None:
            return None
        self._kept = {}
        return self._keep

    def _keep(self, block: Samples) -> None:
        begin = block.t[-1] - SPAN
        first = int(block.t.searchsorted(begin, side="right"))
        for name in ("force", "displacement", "pressure"):
            if name in block.values:
                t, y = block.t[first:], block.values[name][first:]
                if first == 0 and name in self._kept:
                    before, values = self._kept[name]
                    recent = before > begin
                    t, y = np.concatenate((before[recent], t)), np.concatenate((values[recent], y))
                self._kept[name] = t, y

    def verdict(self) -> LoadVerdict | None:
        """The verdict if the load hung still at the end of the observed samples, else None."""
        if self._pending is None or not {"force", "displacement"} <= self._kept.keys():
            return None
        force, asked, before, vented = self._pending
        (t, x), (_, pull) = self._kept["displacement"], self._kept["force"]
        if len(t) < 5 or t[-1] - t[0] < 0.5 * SPAN or not (np.isfinite(x).all() and np.isfinite(pull).all()):
            return None
        contraction, P = float(x.mean()) - before, self._kept.get("pressure", (t, np.zeros(1)))[1]
        moves = contraction > LIFTED or (contraction < -LIFTED and P.min() > vented + UNDER_PRESSURE)
        if not moves or x.max() - x.min() > STILL or self._cell is None:
            return None
        self._pending = None
        known = self._cell.calibration
        tolerance = self._share * force + known.offset_uncertainty + known.gain_uncertainty * force
        return LoadVerdict(force, float(pull.mean()), tolerance, asked, contraction)
