"""The session: self-test, warm-up and zeros as one run of kind `session`; later runs take its zeros while it counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import timedelta
from pathlib import Path
from typing import Any

from pmabench.base.errors import PmaError
from pmabench.base.quantities import in_words
from pmabench.bench.compile import Mounted
from pmabench.bench.session import WarmUp
from pmabench.engine.executor import Executor, Progress
from pmabench.engine.operator import Operator
from pmabench.engine.run import Outcome, run_plan
from pmabench.protocol.plan import Hold, Record, Set
from pmabench.session import state
from pmabench.session.checks import Check
from pmabench.session.guided import guided_plan
from pmabench.session.self_test import SelfTesting, refuse_backwards
from pmabench.session.zeros import ZeroTaken, as_data, take_zeros, with_zeros

SCHEMA = "pmabench.session/1"


class SessionFailed(PmaError):
    """The session did not come to its end: nothing runs on this bench before it has."""

    def __init__(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self.exit_code = outcome.exit_code
        where = f" (recorded in {outcome.folder})" if outcome.folder is not None else ""
        super().__init__(f"the session before the run ended early, {outcome.status}: {outcome.why}{where}")


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
    """The bench with the zeros of its session, which is done first where none counts (or `anew`).

    A bench whose file declares no session is given back as it is. `skip_warm_up` is why the warm-up is left out; the
    record says so. `say` gets a line on what is done and why, `report` the self-test's table. Raises SessionFailed.
    """
    if mounted.session is None:
        return mounted
    session = state.kept(mounted.bench.name)
    why = "asked for" if anew else state.out_of_date(session, mounted, state.utc_now())
    if why:
        say(f"a session comes first, because {why}" if not anew else "a new session, as asked for")
        session = _hold(mounted, operator, out, operator_name, skip_warm_up, report, progress, begun)
        if out is not None:
            state.keep(mounted.bench.name, session)
    else:
        say(f"session {session['run']} of {session['at']} counts until {session['valid_until']}")
    zeros = {str(name): float(zero["value"]) for name, zero in session["zeros"].items()}
    about = {key: session[key] for key in ("run", "at", "valid_until", "zeros", "skipped", "shortened", "operator")}
    return with_zeros(mounted, zeros, about)


def _hold(
    mounted: Mounted,
    operator: Operator,
    out: Path | None,
    operator_name: str,
    skip_warm_up: str,
    report: Callable[[Sequence[Check]], None],
    progress: Callable[[Progress], None],
    begun: Callable[[Path], None],
) -> dict[str, Any]:
    """Execute the run of the session; its results, to be kept for later runs."""
    declared = mounted.session
    assert declared is not None  # noqa: S101  (looked at before)
    skipped = {"warm-up": skip_warm_up} if skip_warm_up and declared.warm_up is not None else {}
    shortened = list(declared.shortened())
    started = state.utc_now()
    zeros: dict[str, ZeroTaken] = {}
    test = SelfTesting(mounted, report) if declared.self_test is not None else None

    def procedure(executor: Executor) -> None:
        executor.recorder.event("session", executor.clock.now(), skipped=skipped, shortened=shortened)
        executor.acquisition.record(on=True)
        if test is not None:
            test.run(executor)
        if declared.warm_up is not None and not skipped:
            _warm_up(executor, declared.warm_up)
        zeros.update(take_zeros(executor, mounted))
        executor.recorder.event("zeros", executor.clock.now(), channels=as_data(zeros))
        executor.acquisition.record(on=False)

    outcome = run_plan(
        guided_plan(mounted, "session", f"session of {mounted.bench.name}"),
        mounted,
        operator,
        out=out,
        operator_name=operator_name,
        deviations=[*(f"{what} skipped because {why}" for what, why in skipped.items()), *shortened],
        progress=progress,
        begun=begun,
        before_proof=test.before_proof if test is not None else lambda _executor: None,
        procedure=procedure,
    )
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
        "operator": operator_name,
        "specimen": state.specimen(mounted),
        "calibrations": state.calibrations(mounted),
        "zeros": as_data(zeros),
        "self_test": [asdict(check) for check in test.checks] if test is not None else [],
        "skipped": skipped,
        "shortened": shortened,
    }


def _warm_up(executor: Executor, warm_up: WarmUp) -> None:
    """Cycles between no pressure and the warm-up's."""
    clock = executor.clock
    end = clock.now() + warm_up.duration
    executor.recorder.event("warm-up", clock.now(), duration=warm_up.duration, pressure=warm_up.pressure)
    executor.acquisition.record(on=False)
    cycles = 0
    rest = executor.acquisition.latest.get("displacement")
    while clock.now() < end - 1e-6:
        for pressure in (warm_up.pressure, 0.0):
            left = end - clock.now()
            executor.progress(Progress(cycles, cycles, None, 0, clock.now(), left, f"warm-up, {in_words(left)} left"))
            executor.do(Set("warm-up", "pressure", pressure))
            executor.do(Hold("warm-up", min(warm_up.period / 2, max(end - clock.now(), 0.1))))
            if cycles == 0 and pressure and rest is not None:
                refuse_backwards(executor, rest)
        cycles += 1
    executor.do(Record("warm-up", on=True))
    executor.recorder.event("warmed-up", clock.now(), cycles=cycles)
