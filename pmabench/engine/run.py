"""One run from opening the bench to the sealed folder: identify, record, arm, execute, vent on every way out, close."""

from __future__ import annotations

import getpass
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench import __version__
from pmabench.base.clock import Clock, RealClock, VirtualClock
from pmabench.base.errors import DeviceError, Interrupted, LimitTripped, PmaError, RecordError, VerdictFailed
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import CompiledBench
from pmabench.engine.acquire import Acquisition, Forgiving, NoRecord, Recorder
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.signals import Signals
from pmabench.guard.guard import Guard, Vent
from pmabench.protocol.plan import Plan
from pmabench.store.naming import run_name

if TYPE_CHECKING:
    from pmabench.store.writer import RunWriter


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
    events: tuple[tuple[str, float, dict[str, Any]], ...] = ()
    """Events of a run that was only tried."""


class _Waiting:
    """An operator who can be interrupted while the program waits for the answer."""

    def __init__(self, operator: Operator, signals: Signals) -> None:
        self._operator, self._signals = operator, signals

    def ask(self, text: str, measured: Mapping[str, float]) -> str:
        """As the operator answers."""
        self._signals.waiting = True
        try:
            return self._operator.ask(text, measured)
        finally:
            self._signals.waiting = False


def run_plan(
    plan: Plan,
    mounted: Mounted,
    operator: Operator,
    *,
    out: Path | None,
    protocol_text: str = "",
    operator_name: str = "",
    deviations: Sequence[str] = (),
    progress: Callable[[Progress], None] = lambda _progress: None,
) -> Outcome:
    """Execute `plan` on the mounted bench and record it in a new folder below `out` (None: try it, keep nothing).

    The bench is driven to its safe state on every way out, and the result of that is in the record before its end mark.
    Raises DeviceError, LimitRefused or RecordError only where it failed before anything was commanded.
    """
    clock: Clock = RealClock() if mounted.bench.realtime else VirtualClock()
    guard = Guard(mounted.bench, clock)
    guard.open()
    try:
        simulated = any(identity.simulated for identity in guard.identities.values())
        if not mounted.bench.realtime and not all(identity.simulated for identity in guard.identities.values()):
            raise DeviceError(mounted.bench.name, '"time: virtual" is for simulated devices only')
        bench = replace(mounted.bench, simulated=simulated)
        recorder: Recorder = NoRecord()
        writer: RunWriter | None = None
        if out is not None:
            writer = _new_folder(plan, mounted, bench, guard, out, protocol_text, operator_name, deviations)
            recorder = writer
        with Signals() as signals:
            return _guarded(plan, bench, guard, clock, recorder, writer, _Waiting(operator, signals), signals, progress)
    finally:
        guard.close()


def _new_folder(
    plan: Plan,
    mounted: Mounted,
    bench: CompiledBench,
    guard: Guard,
    out: Path,
    protocol_text: str,
    operator_name: str,
    deviations: Sequence[str],
) -> RunWriter:
    from pmabench.store.writer import RunWriter

    started = datetime.now(UTC)
    specimen = mounted.specimen_file
    name = run_name(started, f"{specimen.type}-{specimen.serial}", plan.kind, bench.simulated)
    manifest = {
        "kind": plan.kind,
        "protocol": plan.name,
        "source": plan.source,
        "simulated": bench.simulated,
        "started_utc": started.isoformat(timespec="milliseconds"),
        "operator": operator_name or _user(),
        "bench": bench.name,
        "specimen": specimen.model_dump(mode="json", by_alias=True, exclude={"expected"}),
        "devices": guard.describe(),
        "plan_sha256": plan.sha256,
        "trials_planned": len(plan.trials),
        "rate": plan.rate,
        "lacks": list(mounted.lacks),
        "hazards": list(plan.hazards),
        "deviations": list(deviations),
        "pmabench": __version__,
    }
    snapshots = {name: text.encode() for name, text in mounted.documents.items()}
    snapshots |= {
        "protocol.yaml": protocol_text.encode(),
        "plan.json": plan.to_json().encode(),
        "bench.json": bench.to_json().encode(),
    }
    writer = RunWriter.create(out, name, manifest, snapshots)
    for device in bench.devices:
        columns = [asdict(channel) for channel in device.channels if channel.name in plan.record]
        if columns:
            writer.open_stream(device.name, columns, plan.rate)
    return writer


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "unknown"


def _guarded(
    plan: Plan,
    bench: CompiledBench,
    guard: Guard,
    clock: Clock,
    recorder: Recorder,
    writer: RunWriter | None,
    operator: Operator,
    signals: Signals,
    progress: Callable[[Progress], None],
) -> Outcome:
    acquisition = Acquisition(bench, guard.devices, clock, plan.rate, plan.record, recorder)
    acquisition.check = signals.check
    executor = Executor(plan, bench, guard, acquisition, recorder, operator, clock, progress)
    cause: BaseException | None = None
    try:
        acquisition.start()
        recorder.event("armed", clock.now(), bench=bench.name)
        guard.arm()
        acquisition.pass_time(0.1)
        executor.run()
        if executor.failed:
            failed = ", ".join(str(index) for index in executor.failed)
            cause = VerdictFailed(f"{len(executor.failed)} of {len(plan.trials)} trials failed: {failed}")
    except BaseException as error:  # every way out leads through the safe state below
        cause = error
    signals.shut()
    acquisition.begin_safe_state()
    vent = guard.safe_state(acquisition.measure, tripped=isinstance(cause, LimitTripped))
    ending = Forgiving(recorder)
    executor.recorder = ending
    executor.end_trial("interrupted")
    if isinstance(cause, LimitTripped):
        ending.event("trip", clock.now(), reason=str(cause))
    elif cause is not None:
        ending.event("ended-early", clock.now(), reason=_sentence(cause))
    ending.event("vent", clock.now(), result=vent.result, actions=list(vent.actions))
    lost = cause if isinstance(cause, RecordError) else acquisition.lost or ending.lost
    try:
        acquisition.stop()
    except Exception as error:  # the run is over and vented; what is left is to say so
        cause = cause or error
    status, why = _status(cause)
    if not vent.confirmed and bench.safe_state:
        why = f"{why}; safe state {vent.result}".lstrip("; ")
    folder = writer.folder if writer is not None else None
    if writer is not None:
        try:
            writer.close(
                status,
                why,
                vent={"result": vent.result, "actions": list(vent.actions)},
                counts=dict(acquisition.counts),
                trials_failed=list(executor.failed),
                bench_seconds=clock.now(),
            )
        except RecordError as error:
            lost = lost or error
    if lost is not None and not isinstance(cause, RecordError):
        status, why = "error", str(lost)
    return Outcome(
        status,
        why,
        exit_code(cause, lost, vent),
        vent,
        folder,
        clock.now(),
        acquisition.counts["rows"],
        tuple(executor.failed),
        dict(acquisition.extremes),
        tuple(recorder.events) if isinstance(recorder, NoRecord) else (),
    )


def _sentence(cause: BaseException) -> str:
    if isinstance(cause, PmaError):
        return str(cause)
    return "".join(traceback.format_exception(cause))


def _status(cause: BaseException | None) -> tuple[str, str]:
    if cause is None:
        return "finished", ""
    if isinstance(cause, Interrupted):
        return "aborted", str(cause)
    if isinstance(cause, LimitTripped):
        return "tripped", str(cause)
    if isinstance(cause, VerdictFailed):
        return "failed", str(cause)
    if isinstance(cause, PmaError):
        return "error", str(cause)
    return "error", f"{type(cause).__name__}: {cause}"


def exit_code(cause: BaseException | None, lost: RecordError | None, vent: Vent) -> int:
    """When causes meet the worst wins: vent not confirmed, record lost, device, interrupted, verdict."""
    if vent.result == "failed" or isinstance(cause, LimitTripped):
        return 5
    if lost is not None:
        return 7
    if not vent.confirmed:
        return 5
    if cause is None:
        return 0
    return cause.exit_code if isinstance(cause, PmaError) else 1
