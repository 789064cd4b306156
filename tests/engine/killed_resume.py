"""Runs of 20 trials in virtual time that are killed (SIGKILL, by themselves, at a write) and gone on with until done.

`python -m tests.engine.killed_resume FOLDER KILLS SEED [KIND]` prints the last run folder of each chain, whether that
was killed after its last trial (then nothing is left to do), and how many writes a whole run has. The program imports
once and forks a child for each run.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

SETTINGS = (
    ("sweep.matrix.load", "[6 kg, 11 kg]"),
    ("sweep.matrix.pressure", "[100 kPa, 150 kPa, 200 kPa, 250 kPa, 300 kPa]"),
    ("sweep.repeat.count", "2"),
    ("prepare.precondition.cycles", "1"),
    ("trial.contract.hold", "0.5 s"),
    ("trial.relax.hold", "0.2 s"),
    ("trial.relax.hold_at_end", "0.2 s"),
)


_FEW = (("prepare.precondition.cycles", "1"), ("sample_rate", "50 Hz"))
ONCE = ("pmabench.engine.resume", "pmabench.engine.run", "pmabench_drivers.mock", "pyarrow.parquet", "scipy.integrate")
"""What every child needs."""
KINDS = {
    "contraction-relaxation": ("mock", "mas-20-250-paper0", SETTINGS),
    "ultimate-gain-relay": (
        "mock-linear",
        "mas-20-250-paper0",
        (_FEW[0], ("sweep.repeat.count", "5"), ("trial.relay.periods", "8"), ("trial.relay.settle", "1 s")),
    ),
    "closed-volume": (
        "mock-daerden-closed",
        "daerden-20-200",
        (*_FEW, ("trial.speed", "12 mm/s"), ("trial.settle", "1 s"), ("sweep.repeat.count", "5")),
    ),
    "free-contraction": (
        "mock-contractor-free",
        "contractor-30",
        (
            *_FEW,
            ("sweep.repeat.count", "1"),
            ("sweep.matrix.pressure", "[0 bar, 1 bar, 2 bar, 3 bar, 5 bar]"),
            ("trial.hold", "1 s"),
            ("trial.rest", "1 s"),
        ),
    ),
    "arm-angle": (
        "mock-arm",
        "arm-30",
        (*_FEW, ("sweep.repeat.count", "2"), ("trial.pressures", "[1 bar, 3 bar]"), ("trial.hold", "1 s")),
    ),
}
"""Protocol -> bench, specimen, and what makes it short."""


def main() -> None:
    """Make chains of killed runs."""
    from pmabench.cli.prepare import prepare

    for name in ONCE:
        import_module(name)
    out, kills, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    out.mkdir(parents=True)
    kind = sys.argv[4] if len(sys.argv) > 4 else "contraction-relaxation"
    prepared = prepare(kind, *KINDS[kind])
    random, done, chains = Random(seed), 0, []
    writes = int(_child(prepared, out / "whole", None, None)["writes"])
    while done < kills:
        place, before = out / str(len(chains)), None
        while True:
            at = random.randrange(1, writes // 3 if kind == "contraction-relaxation" else 2 * writes // 3)
            reported = _child(prepared, place, before, at)
            if reported.get("folder"):
                before = reported["folder"]
            if reported["code"] is not None:
                break
            done += 1
        chains.append(
            {
                "last": before,
                "killed_at_the_end": reported.get("nothing_left", False),
                "end": [reported["code"], reported.get("why", "")],
            }
        )
    sys.stdout.write(json.dumps({"chains": chains, "kills": done, "writes": writes}) + "\n")


def _child(prepared: Any, out: Path, before: str | None, at: int | None) -> dict[str, Any]:
    """One run in a child; what is known of it afterwards: `code` is None where it was killed."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os._exit(_run(prepared, out, before, at, write))
    os.close(write)
    with os.fdopen(read) as pipe:
        lines = [json.loads(line) for line in pipe]
    _, status = os.waitpid(pid, 0)
    reported: dict[str, Any] = {"code": None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)}
    for line in lines:
        reported |= line
    return reported


def _run(prepared: Any, out: Path, before: str | None, at: int | None, tell: int) -> int:
    from pmabench.base.errors import InvalidFile
    from pmabench.engine.operator import ConfirmedBeforehand
    from pmabench.engine.resume import continue_run
    from pmabench.engine.run import run_plan
    from pmabench.store.writer import RunWriter

    count = 0
    whole = {"append": RunWriter.append, "event": RunWriter.event}

    def counted(name: str) -> Any:
        def call(self: Any, *data: Any, **more: Any) -> None:
            nonlocal count
            count += 1
            if count == at:
                os.kill(os.getpid(), signal.SIGKILL)
            whole[name](self, *data, **more)

        return call

    RunWriter.append, RunWriter.event = counted("append"), counted("event")  # type: ignore[method-assign]

    def say(**what: Any) -> None:
        os.write(tell, json.dumps(what).encode() + b"\n")

    continues = None
    if before is not None:
        try:
            continues = continue_run(Path(before), prepared.plan, prepared.mounted, prepared.protocol_text)
        except InvalidFile as error:
            say(nothing_left="nothing is left to do" in str(error), why=str(error))
            return 0
    outcome = run_plan(
        prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=out, protocol_text=prepared.protocol_text,
        continues=continues, begun=lambda folder: say(folder=str(folder)),
    )  # fmt: skip
    say(writes=count, why=outcome.why)
    return outcome.exit_code


if __name__ == "__main__":
    main()
