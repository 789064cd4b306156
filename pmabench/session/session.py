"""The session: self-test, warm-up and zeros as one run of kind `session`; later runs use its zeros while it is valid.

Zeros change the offsets of a bench's channels; the calibration is unchanged. Also: the stored session of a bench, why
it is no longer valid, and the predicted duration.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from pmabench.base.errors import PmaError, VerdictFailed
from pmabench.base.quantities import CHANNEL_QUANTITY, in_words, show, without_number
from pmabench.bench.compile import Mounted
from pmabench.bench.files.session import PLACED
from pmabench.bench.interface import ChannelRecord, Scale
from pmabench.bench.session import WarmUp, Zero
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.run import Outcome
from pmabench.guard.station import Station
from pmabench.protocol.plan import Ask, Hold, Record, Set, WaitUntil
from pmabench.session.checks import Check
from pmabench.session.guided import guided_run, put_on, steady
from pmabench.session.self_test import SelfTesting, refuse_backwards

FILE = "session"


def kept(bench: str) -> dict[str, Any]:
    """Stored data of the last session of a bench; empty without one."""
    return Station(bench).read(FILE)


def keep(bench: str, session: Mapping[str, Any]) -> None:
    """Store the session of a bench."""
    station = Station(bench)
    station.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    station.write(FILE, session)


def calibrations(mounted: Mounted) -> dict[str, dict[str, Any]]:
    """Calibration of each channel, without any zero."""
    return {
        channel.name: {
            "id": channel.calibration.id,
            "sha256": channel.calibration.sha256,
            "slope": channel.scale.slope,
            "offset": channel.calibrated.offset,
        }
        for channel in mounted.bench.channels
    }


def specimen(mounted: Mounted) -> str:
    """The mounted specimen and its length, as text: zeros are valid for it only."""
    file = mounted.specimen_file
    return f"{file.type} {file.serial}, {file.mounted.length:g} m, {file.mounted.date}"


def out_of_date(session: Mapping[str, Any], mounted: Mounted, now: datetime) -> str:
    """Why a stored session is not valid for this bench now, in words; empty if it is."""
    if not session:
        return "there is none yet"
    try:
        begun, ends = (datetime.fromisoformat(session[key]) for key in ("at", "valid_until"))
        if not begun <= now + timedelta(minutes=1):
            return "it is from the future: the clock of this computer was changed"
        if now >= ends:
            return f"it has run out: it is {in_words((now - begun).total_seconds())} old"
        if session["specimen"] != specimen(mounted):
            return f"another specimen is mounted now; then it was {session['specimen']}"
        if session["calibrations"] != calibrations(mounted):
            names = sorted(
                name for name, one in calibrations(mounted).items() if session["calibrations"].get(name) != one
            )
            return f"channels or calibrations have changed: {', '.join(names) or 'one is gone'}"
        missing = sorted(set(mounted.session.zeros if mounted.session is not None else ()) - set(session["zeros"]))
        if missing:
            return f"it has no zero of {', '.join(missing)}"
    except (KeyError, TypeError, ValueError, AttributeError):
        return "what is kept of it cannot be read"
    return _disturbed(mounted.bench.name, begun)


def _disturbed(bench: str, since: datetime) -> str:
    """A sentence if the bench was tripped or reset after `since`, by its journal; else empty."""
    with suppress(OSError):
        for text in (Station(bench).folder / "journal.jsonl").read_text("utf-8").splitlines():
            with suppress(KeyError, TypeError, ValueError):
                line = json.loads(text)
                at, reset = datetime.fromisoformat(str(line["at"])), line.get("why") == "reset"
                if at >= since.replace(microsecond=0) and (line["what"] == "tripped" or reset):
                    return f"the bench was {'reset' if reset else 'tripped'} since then"
    return ""


def utc_now() -> datetime:
    """Wall clock time."""
    return datetime.now(UTC)


PHASE = "zeros"
DRIFT = 0.2
"""Largest drift while a zero is taken, as a fraction of its limit."""
STEADY = 1.0
"""Averaging time of a zero [s]."""
STEADY_WITHIN = 30.0
"""Longest time for a channel to come to rest [s]."""


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
    """Take the zeros that the bench's session asks for.

    First pressures, vented with the valves open; then the force, unloaded by the operator; then displacement and
    angle at their stated references. Raises ZeroRefused, or VerdictFailed if a channel does not come to rest.
    """
    wanted = mounted.session.zeros if mounted.session is not None else {}
    taken: dict[str, ZeroTaken] = {}
    _vent(executor)
    pressures = [name for name in wanted if without_number(name)[0] == "pressure"]
    if pressures:
        executor.guard.valves(closed=False)
        taken |= {name: _take(executor, name, wanted[name], "vented, valves open") for name in pressures}
        executor.guard.valves(closed=True)
    if "force" in wanted:
        put_on(executor, mounted, PHASE, 0.0)
        taken["force"] = _take(executor, "force", wanted["force"], "unloaded")
    for name in (name for name in PLACED if name in wanted):
        zero = wanted[name]
        text = f"Bring the free end to where its {name} is zero: {zero.at}."
        if zero.load is None:
            executor.do(Ask(PHASE, text, "vented"))
        else:
            put_on(executor, mounted, PHASE, zero.load, text)
        taken[name] = _take(executor, name, zero, zero.at)
    return taken


def _vent(executor: Executor) -> None:
    """Set every output to its safe value, and wait until the pressures are gone."""
    for output in executor.bench.outputs:
        executor.do(Set(PHASE, output.name, output.safe))
    for channel in executor.bench.channels:
        if without_number(channel.name)[0] == "pressure":
            below = executor.bench.hands_below
            executor.do(WaitUntil(PHASE, channel.name, "below", below, 0.1, STEADY_WITHIN, "flag"))


def _take(executor: Executor, name: str, zero: Zero, condition: str) -> ZeroTaken:
    reading = steady(executor.acquisition, name, DRIFT * zero.most, seconds=STEADY, within=STEADY_WITHIN)
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
    """The bench with zeros [SI] subtracted from its channels' offsets; `about` describes the session in manifests."""

    def zeroed(channel: ChannelRecord) -> ChannelRecord:
        zero = zeros.get(channel.name)
        if zero is None or channel.zero is not None:
            return channel
        return replace(channel, scale=Scale(channel.scale.slope, channel.scale.offset - zero), zero=zero)

    devices = tuple(replace(one, channels=tuple(map(zeroed, one.channels))) for one in mounted.bench.devices)
    return replace(mounted, bench=replace(mounted.bench, devices=devices), in_session=about)


def as_data(taken: Mapping[str, ZeroTaken]) -> dict[str, dict[str, Any]]:
    """Plain data for records and state."""
    return {name: asdict(zero) for name, zero in taken.items()}


def parts(mounted: Mounted) -> list[str]:
    """What the session of a bench consists of; empty if its file declares none."""
    declared = mounted.session
    if declared is None:
        return []
    found = ["self-test"] if declared.self_test is not None else []
    found += [f"warm-up of {in_words(declared.warm_up.duration)}"] if declared.warm_up is not None else []
    return [*found, *(["zeros"] if declared.zeros else [])]


SCHEMA = "pmabench.session/1"


class SessionFailed(PmaError):
    """The session was not completed; the bench may not run before it is."""

    def __init__(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self.exit_code = outcome.exit_code
        vent = f"; vent {outcome.vent.result}" if outcome.vent is not None else ""
        again = "; the same command begins with a session again"
        where = f"\nrecorded in {outcome.folder}" if outcome.folder is not None else ""
        said = f"the session before the run ended early, {outcome.status}: {outcome.why}{vent}{again}{where}"
        super().__init__(said)


def ensure(
    mounted: Mounted,
    operator: Operator,
    out: Path | None,
    *,
    operator_name: str = "",
    skip_warm_up: str = "",
    anew: bool = False,
    say: Callable[[str], None] = lambda _line: None,
    report: Callable[[Sequence[Check]], None] = lambda _checks: None,
    progress: Callable[[Progress], None] = lambda _progress: None,
    begun: Callable[[Path], None] = lambda _folder: None,
) -> Mounted:
    """The bench with the zeros of its session, which is held first if none is valid (or `anew`).

    A bench whose file declares no session is returned unchanged. `skip_warm_up` is the reason for leaving the warm-up
    out, kept in the record. `say` gets a line on what is done and why, `report` the self-test's table. Raises
    SessionFailed.
    """
    if mounted.session is None:
        return mounted
    session = kept(mounted.bench.name)
    why = "asked for" if anew else out_of_date(session, mounted, utc_now())
    tripped = mounted.bench.realtime and Station(mounted.bench.name).latched()
    if why:
        if not tripped:  # else the bench is refused, and no session comes
            say(f"a session comes first, because {why}" if not anew else "a new session, as asked for")
        run: dict[str, Any] = {"out": out, "operator_name": operator_name, "progress": progress, "begun": begun}
        session = _hold(mounted, operator, skip_warm_up, report, run)
        if out is not None:
            keep(mounted.bench.name, session)
    else:
        at, until = (datetime.fromisoformat(session[key]).astimezone() for key in ("at", "valid_until"))
        say(f"session {session['run']} of {at:%H:%M} counts until {until:%Y-%m-%d %H:%M}")
    zeros = {str(name): float(zero["value"]) for name, zero in session["zeros"].items()}
    about = {key: session[key] for key in ("run", "at", "valid_until", "zeros", "skipped", "shortened", "operator")}
    about["devices"] = session.get("devices", {})
    return with_zeros(mounted, zeros, about)


def _hold(
    mounted: Mounted,
    operator: Operator,
    skip_warm_up: str,
    report: Callable[[Sequence[Check]], None],
    run: Mapping[str, Any],
) -> dict[str, Any]:
    """Run the session, with the arguments `run` for `guided_run`; returns the results to be stored for later runs."""
    declared = mounted.session
    assert declared is not None  # noqa: S101  (looked at before)
    skipped = {"warm-up": skip_warm_up} if skip_warm_up and declared.warm_up is not None else {}
    shortened = list(declared.shortened(warm_up=not skipped))
    started = utc_now()
    zeros: dict[str, ZeroTaken] = {}
    test = SelfTesting(mounted, report) if declared.self_test is not None else None

    def procedure(executor: Executor) -> None:
        executor.event("session", skipped=skipped, shortened=shortened)
        executor.acquisition.record(on=True)
        if test is not None:
            test.run(executor)
        if declared.warm_up is not None and not skipped:
            _warm_up(executor, declared.warm_up)
        zeros.update(take_zeros(executor, mounted))
        executor.event("zeros", channels=as_data(zeros))
        executor.acquisition.record(on=False)

    if test is not None:
        run = {**run, "before_proof": test.before_proof}
    deviations = [*(f"{what} skipped because {why}" for what, why in skipped.items()), *shortened]
    name = f"session of {mounted.bench.name}"
    outcome = guided_run(mounted, operator, "session", name, procedure, deviations=deviations, **run)
    if test is not None:
        test.ended(outcome)
    if outcome.exit_code:
        raise SessionFailed(outcome)
    return {
        "schema": SCHEMA,
        "run": outcome.folder.name if outcome.folder is not None else "not recorded",
        "bench": mounted.bench.name,
        "at": started.isoformat(timespec="seconds"),
        "valid_until": (started + timedelta(seconds=declared.valid)).isoformat(timespec="seconds"),
        "operator": run["operator_name"],
        "specimen": specimen(mounted),
        "calibrations": calibrations(mounted),
        "zeros": as_data(zeros),
        "devices": {name: one.serial for name, one in outcome.identities.items()},
        "self_test": [asdict(check) for check in test.checks] if test is not None else [],
        "skipped": skipped,
        "shortened": shortened,
    }


def _warm_up(executor: Executor, warm_up: WarmUp) -> None:
    """Cycle between zero and the warm-up's pressure."""
    clock = executor.clock
    end = clock.now() + warm_up.duration
    executor.event("warm-up", duration=warm_up.duration, pressure=warm_up.pressure)
    executor.acquisition.record(on=False)
    cycles = 0
    rest = executor.acquisition.latest.get("displacement")
    while clock.now() < end - 1e-6:
        for pressure in (warm_up.pressure, 0.0):
            left = end - clock.now()
            executor.progress(Progress(cycles, cycles, None, 0, clock.now(), left, f"warm-up, {in_words(left)} left"))
            for output in executor.bench.outputs:
                if output.quantity == "pressure":
                    executor.do(Set("warm-up", output.name, pressure))
            executor.do(Hold("warm-up", min(warm_up.period / 2, max(end - clock.now(), 0.1))))
            if cycles == 0 and pressure and rest is not None:
                refuse_backwards(executor, rest)
        cycles += 1
    executor.do(Record("warm-up", on=True))
    executor.event("warmed-up", cycles=cycles)
