"""One run from opening the bench to the sealed folder: identify, record, arm, execute, vent on every way out, close."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench import __version__
from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import DeviceError, Interrupted, LimitTripped, RecordError, VerdictFailed
from pmabench.base.quantities import show
from pmabench.base.system import ENGINE, ordinary, real_time, user_name
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import CompiledBench, Identity, OutputRecord, TripRecord
from pmabench.engine.acquire import Acquisition, Tripped
from pmabench.engine.bench_checks import (
    LoadImplausible,
    agree,
    as_data,
    await_drives,
    not_proven,
    prove,
    refuse_other_zeros,
    refuse_slow,
    refuse_twice,
)
from pmabench.engine.ending import Signals, ahead, clock_set, exit_code, sentence, status_of, zero_check
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.recorder import Forgiving, NoRecord, Recorder
from pmabench.engine.source import OwnDevices
from pmabench.guard.guard import Guard, Vent
from pmabench.guard.remote import AnyGuard, RemoteGuard
from pmabench.protocol.plan import Plan, Step, TrialRecord
from pmabench.store.folder import run_name

if TYPE_CHECKING:
    from pmabench.store.writer import RunWriter


LOOK, FOLLOWS = 0.1, 1.5
"""Interval at which a controlled stop checks the pressure, and time after which it must have fallen [s] ..."""
FALLEN, FOLLOWED, BEHIND = 20e3, 0.2, 0.5
"""... if the command fell by at least the first [Pa]. The pressure must fall by the second number's share of the
command's fall [1], or lag behind it by less than the third number's share."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    status: str
    why: str
    exit_code: int
    vent: Vent | None
    folder: Path | None
    bench_seconds: float
    rows: int
    trials_failed: tuple[int, ...]
    extremes: Mapping[str, tuple[float, float]]
    """Lowest and highest value [SI] measured on each channel."""
    tripped: TripRecord | None = None
    """The limit on a measured channel that ended it, if one did."""
    events: tuple[tuple[str, float, dict[str, Any]], ...] = ()
    """Events (kind, bench time [s], data) of a dry run; empty for a recorded run."""
    trials_done: int = 0
    """Number of completed trials, including those of the run that this one continues."""
    identities: Mapping[str, Identity] = field(default_factory=dict)
    """Identity that each device reported, by its name."""


class Waiting:
    """Wraps an operator so that a signal interrupts the wait for an answer at once."""

    def __init__(self, operator: Operator, signals: Signals) -> None:
        self._operator, self._signals = operator, signals
        self.poll = operator.poll

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """The operator's answer; raises Interrupted on a signal."""
        self._signals.waiting = True

        def waited() -> None:
            self._signals.waiting = False
            wait()
            self._signals.waiting = True

        try:
            return self._operator.ask(text, measured, waited)
        finally:
            self._signals.waiting = False


@dataclass(frozen=True)
class Continues:
    """What a new run needs to continue an earlier one (`pmabench run --resume`)."""

    manifest: Mapping[str, Any]
    """Entry `continues` of the new manifest."""
    steps: tuple[Step, ...]
    """The remaining steps."""
    again: TrialRecord | None
    """The reference trial that is repeated first, if any."""
    attempts: Mapping[int, int]

    @property
    def left(self) -> dict[str, Any]:
        """Keyword arguments for the executor."""
        done = set(self.manifest["trials_done"])
        return {"steps": self.steps, "again": self.again, "attempts": dict(self.attempts), "finished": done}


def run_plan(
    plan: Plan,
    mounted: Mounted,
    operator: Operator,
    *,
    out: Path | None,
    protocol_text: str = "",
    operator_name: str = "",
    deviations: Sequence[str] = (),
    about: Mapping[str, Any] | None = None,
    progress: Callable[[Progress], None] = lambda _progress: None,
    continues: Continues | None = None,
    begun: Callable[[Path], None] = lambda _folder: None,
    before_proof: Callable[[Executor], None] = lambda _executor: None,
    procedure: Callable[[Executor], None] = Executor.run,
    trying: NoRecord | None = None,
    further: Callable[[Executor], Callable[[], Sequence[Step]]] | None = None,
) -> Outcome:
    """Execute `plan` on the mounted bench and record it in a new folder below `out` (None: dry run, nothing is stored).

    `about` is added to the manifest. `procedure` runs on the armed bench: the plan's steps, or a guided procedure
    (session, calibration, jog) that uses the executor's guard, acquisition, operator and recorder, with the same limits
    and the same ending. `before_proof` runs before the proof test, without pressure. `trying` receives the samples of a
    dry run. With `further` (see `Choosing`) trials are chosen one by one instead of in the plan's order.

    The bench is driven to its safe state whatever ends the run, and the result of that is recorded before the run is
    sealed. `begun` is called with the new folder. Raises DeviceError, LimitRefused or RecordError only before anything
    was commanded, InvalidFile for a bench in real time with unconfirmed values.
    """
    mounted.refuse_unconfirmed()
    bench = mounted.bench
    clock: RealClock | VirtualClock = RealClock() if bench.realtime else VirtualClock()
    guard: AnyGuard = RemoteGuard(bench, clock) if isinstance(clock, RealClock) else Guard(bench, clock)
    own = OwnDevices(bench, clock)
    try:
        why = real_time(ENGINE) if bench.realtime else ""
        guard.open()
        own.open()
        identities = {**guard.identities, **own.identities}
        bench = _as_answered(bench, (mounted.in_session or {}).get("devices") or {}, identities)
        recorder: Recorder = trying or NoRecord()
        writer: RunWriter | None = None
        if out is not None:
            entries = {"deviations": list(deviations), "operator": operator_name or user_name(), **(about or {})}
            entries |= {} if continues is None else {"continues": dict(continues.manifest)}
            opened = _opened(bench, identities, why or "real time")
            writer = _new_folder(plan, mounted, bench, out, protocol_text, {**opened, **entries})
            recorder = writer
            begun(writer.folder)
        streams = {**guard.devices, **own.streams}
        with Signals() as signals:
            acquisition = Acquisition(bench, streams, clock, plan.rate, plan.record, recorder)
            person = Waiting(operator, signals)
            left: dict[str, Any] = {} if continues is None else continues.left
            executor = Executor(plan, bench, guard, acquisition, recorder, person, clock, progress, **left)
            if further is not None:
                executor.steps, executor.further = executor.steps or (), further(executor)
            with _no_long_collection() if bench.realtime else nullcontext():
                return _Run(executor, guard, own, signals, writer, before_proof, procedure).execute()
    finally:
        guard.close()
        own.close()
        if bench.realtime:
            ordinary()


@contextmanager
def _no_long_collection() -> Iterator[None]:
    """Collect garbage once now, and keep the collector from pausing the run later.

    A full collection stops all threads: 0.37 s were measured on a busy computer, longer than the guard tolerates a
    silent engine.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _as_answered(bench: CompiledBench, zeroed: Mapping[str, Any], identities: Mapping[str, Identity]) -> CompiledBench:
    """The bench, marked as simulated if one of its devices is.

    Raises DeviceError for a real device in virtual time, where one device answers under two names, and where zeros were
    taken with another device (`zeroed`: serial numbers by device name).
    """
    simulated = [identity.simulated for identity in identities.values()]
    if not bench.realtime and not all(simulated):
        raise DeviceError(bench.name, '"time: virtual" is for simulated devices only')
    refuse_twice(bench, identities)
    refuse_other_zeros(bench, zeroed, identities)
    return replace(bench, simulated=any(simulated))


def _opened(bench: CompiledBench, identities: Mapping[str, Identity], priority: str) -> dict[str, Any]:
    """Entries of the manifest about the devices that answered, and about the `priority` of this process."""
    entries: dict[str, Any] = {"devices": {name: vars(identity) for name, identity in identities.items()}}
    entries["drivers"] = as_data(bench)
    if bench.realtime:
        entries["priority"] = priority
    if unproven := not_proven(identities):
        entries["scales_not_proven"] = unproven
    return entries


def _new_folder(
    plan: Plan,
    mounted: Mounted,
    bench: CompiledBench,
    out: Path,
    protocol_text: str,
    about: Mapping[str, Any],
) -> RunWriter:
    from pmabench.store.writer import RunWriter

    started = datetime.now(UTC)
    specimen = mounted.specimen_file
    muscles = {number: {"type": one.type, "serial": one.serial} for number, one in mounted.bench_file.muscles.items()}
    """Number -> type and serial number, where there are several muscles."""
    name = run_name(started, f"{specimen.type}-{specimen.serial}", plan.kind, bench.simulated)
    manifest = {
        "kind": plan.kind,
        "protocol": plan.name,
        "source": plan.source,
        "simulated": bench.simulated,
        "started_utc": started.isoformat(timespec="milliseconds"),
        "bench": bench.name,
        "specimen": specimen.model_dump(mode="json", by_alias=True, exclude={"expected"}),
        **({"muscles": muscles} if muscles else {}),
        "plan_sha256": plan.sha256,
        "trials_planned": len(plan.trials),
        "rate": plan.rate,
        "lacks": list(mounted.lacks),
        "doubts": list(mounted.doubts),
        "session": dict(mounted.in_session) if mounted.in_session is not None else None,
        "hazards": list(plan.hazards),
        "pmabench": __version__,
        **about,
    }
    snapshots = {name: text.encode() for name, text in mounted.documents.items()}
    snapshots |= {
        "protocol.yaml": protocol_text.encode(),
        "plan.json": plan.to_json().encode(),
        "bench.json": bench.to_json().encode(),
    }
    writer = RunWriter.create(out, name, manifest, snapshots)
    writer.waits = not bench.realtime
    return writer


@dataclass
class _Run:
    """One execution of a plan, from arming to the sealed folder."""

    executor: Executor
    guard: AnyGuard
    own: OwnDevices
    signals: Signals
    writer: RunWriter | None
    before_proof: Callable[[Executor], None]
    procedure: Callable[[Executor], None]

    def __post_init__(self) -> None:
        executor = self.executor
        self.acquisition, self.clock, self.bench = executor.acquisition, executor.clock, executor.bench
        self.ahead = ahead()

    def execute(self) -> Outcome:
        """Run it; whatever ends it, the safe state follows."""
        acquisition, executor = self.acquisition, self.executor
        acquisition.check = self._check
        acquisition.on_trip = lambda why, latches, hurry: self.guard.begin_safe(
            tripped=latches, hurry=hurry, why=why, doubted=(*acquisition.doubted,)
        )
        if isinstance(self.guard, RemoteGuard):
            acquisition.beat, self.guard.hurried = self.guard.beat, self.signals.hurry
        cause: BaseException | None = None
        try:
            acquisition.start()
            self._open_streams()
            identities = {**self.guard.identities, **self.own.identities}
            refuse_slow(self.bench, identities, executor.plan.rate, acquisition.rates)
            agree(executor, identities)
            executor.event("armed", bench=self.bench.name)
            self.guard.arm(str(self.writer.folder.resolve()) if self.writer is not None else "")
            acquisition.listen_anew()
            acquisition.pass_time(0.1)
            if self.bench.realtime:
                self.own.supervision.begin()
                acquisition.question = self.own.supervision.look
                acquisition.supervise()
            self.before_proof(executor)
            if self.procedure is Executor.run:
                await_drives(self.bench, acquisition)
            prove(self.bench, self.guard, acquisition, executor.recorder)
            self.procedure(executor)
            if executor.failed:
                failed = ", ".join(str(index + 1) for index in executor.failed)
                cause = VerdictFailed(f"{len(executor.failed)} of {len(executor.plan.trials)} trials failed: {failed}")
        except BaseException as error:  # whatever it is, the safe state below follows
            cause = error
        gently = (isinstance(cause, Interrupted) and self.signals.gently) or isinstance(cause, LoadImplausible)
        if gently or (isinstance(cause, Tripped) and cause.trip.limit.action == "stop"):
            self._controlled_stop()
        return self._end(cause)

    def _open_streams(self) -> None:
        """Open one stream in the record for each device with recorded channels, at the device's actual rate."""
        if self.writer is None:
            return
        for device in self.bench.devices:
            columns = [asdict(channel) for channel in device.channels if channel.name in self.executor.plan.record]
            if columns:
                self.writer.open_stream(device.name, columns, self.acquisition.rates[device.name])

    def _check(self) -> None:
        self.signals.check()
        self.executor.handle_keys()

    def _controlled_stop(self) -> None:
        """Lower the pressures at the bench's stop rate before the safe state; any signal or error ends this at once."""
        now = self.clock.now()
        asked = {output: self.acquisition.commanded.at(output.name, now) for output in self.bench.pressures}
        above = {o: value - o.safe for o, value in asked.items() if value is not None and value > o.safe}
        if not above or not self.bench.stop_rate:
            return
        self.signals.news()
        self.acquisition.check = self.signals.check
        with suppress(BaseException):  # another signal, a trip, a lost device: the safe state follows now
            self.acquisition.begin_controlled_stop()
            now = self.clock.now()
            furthest = max(above.values())
            highest = max(output.safe + way for output, way in above.items())
            self.executor.recorder.event("controlled-stop", now, origin=highest, rate=self.bench.stop_rate)
            for output, way in above.items():  # all arrive together: antagonistic muscles stay balanced
                rate = self.bench.stop_rate * (way / furthest)
                self.guard.ramp(output.name, output.safe + way, output.safe, rate)
                self.acquisition.commanded.ramp(output.name, now, output.safe + way, output.safe, rate)
            self._wait_for_stop(now, furthest / self.bench.stop_rate, above)

    def _wait_for_stop(self, begun: float, lasts: float, above: Mapping[OutputRecord, float]) -> None:
        """Wait for the ramps of a stop; return early, so that the bench is vented, if a pressure does not follow."""
        latest = self.acquisition.latest
        before = {output.name: latest.get(output.name) for output in above}
        while (since := self.clock.now() - begun) < lasts:
            self.acquisition.pass_time(min(LOOK, lasts - since))
            for output, way in above.items():
                was, now, fallen = before[output.name], latest.get(output.name), way * since / lasts
                if was is None or now is None or since < FOLLOWS or fallen < FALLEN:
                    continue
                asked = output.safe + way - fallen
                if now > was - FOLLOWED * fallen and now > asked + BEHIND * fallen:
                    is_, wanted = (show(value, "pressure", 4) for value in (now, asked))
                    why = f"{output.name} is {is_} where the stop commands {wanted}: not followed, so vented now"
                    about = {"limit": f"controlled stop {output.name}", "action": "vent", "value": now}
                    self.executor.event("warning", reason=why, **about)
                    return

    def _measure(self) -> Mapping[str, float]:
        """Newest values for the safe state [SI]; further signals shorten its waits."""
        if hurry := self.signals.hurry():
            self.guard.begin_safe(hurry=hurry)
        self.own.keep_measuring(self.acquisition.rate)
        values: Mapping[str, float] = {}
        try:  # meanwhile the guard still uses the former values
            values = self.acquisition.measure()
        finally:  # after a failure former values must not confirm anything
            if isinstance(self.guard, RemoteGuard):
                self.guard.seen = {name: value for name, value in values.items() if name in self.own.channels}
        return values

    def _end(self, cause: BaseException | None) -> Outcome:
        acquisition, executor = self.acquisition, self.executor
        self.signals.news()
        self.signals.shut()
        why = str(cause) if cause is not None else "end of the run"
        tripped, doubted = isinstance(cause, LimitTripped), (*acquisition.doubted,)
        self.guard.begin_safe(tripped=tripped, why=why, doubted=doubted)  # first: it must not wait
        acquisition.begin_safe_state()
        ending = Forgiving(executor.recorder)
        if isinstance(cause, LimitTripped) and not isinstance(cause, Tripped):
            ending.event("trip", self.clock.now(), reason=str(cause))
        elif cause is not None and not isinstance(cause, Tripped):
            ending.event("ended-early", self.clock.now(), reason=sentence(cause))
        vent = self.guard.safe_state(self._measure, tripped=isinstance(cause, LimitTripped), why=why)
        recorder, executor.recorder = executor.recorder, ending
        executor.end_trial("interrupted")
        ending.event("vent", self.clock.now(), result=vent.result, actions=list(vent.actions))
        if why_set := clock_set(self.ahead):
            ending.event("warning", self.clock.now(), reason=why_set)
        if self.bench.realtime:
            ordinary()  # closing the record needs no priority
        zeros = self._zeros() if vent.confirmed else {}
        if zeros:
            ending.event("zero-check", self.clock.now(), channels=zeros)
        lost = cause if isinstance(cause, RecordError) else acquisition.lost or ending.lost
        try:
            acquisition.stop()
        except Exception as error:  # the run is over and vented; only its status is left to report
            cause = cause or error
        status, why = status_of(cause)
        if not vent.confirmed and self.bench.safe_state:
            why = f"{why}; safe state {vent.result}".lstrip("; ")
        lost = self._close(status, why, vent, zeros) or lost
        if lost is not None and not isinstance(cause, RecordError):
            status, why = "error", str(lost)
        return Outcome(
            status,
            why,
            exit_code(cause, lost, vent),
            vent,
            self.writer.folder if self.writer is not None else None,
            self.clock.now(),
            acquisition.counts["rows"],
            tuple(executor.failed),
            dict(acquisition.extremes),
            cause.trip.limit if isinstance(cause, Tripped) else None,
            tuple(recorder.events) if isinstance(recorder, NoRecord) else (),
            len(executor.finished),
            {**self.guard.identities, **self.own.identities},
        )

    def _zeros(self) -> dict[str, dict[str, Any]]:
        """Check of the session's zeros; empty where no channel was zeroed, or nothing can be measured."""
        zeroed = tuple(channel.name for channel in self.bench.channels if channel.zero is not None)
        if not zeroed:
            return {}
        try:
            return zero_check(self.acquisition, zeroed, unloaded=self.executor.unloaded)
        except Exception:  # the run is over and vented; the check is optional
            return {}

    def _close(self, status: str, why: str, vent: Vent, zeros: Mapping[str, Any]) -> RecordError | None:
        if self.writer is None:
            return None
        try:
            self.writer.close(
                status,
                why,
                vent={"result": vent.result, "actions": list(vent.actions)},
                counts=dict(self.acquisition.counts),
                trials_failed=list(self.executor.failed),
                bench_seconds=self.clock.now(),
                **({"zero_check": zeros} if zeros else {}),
            )
        except RecordError as error:
            return error
        return None
