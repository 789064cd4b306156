"""Runs in real time as processes of their own, forked from one that has imported everything already.

`python -m tests.engine.forked` reads jobs from standard input, a JSON object per line, and answers each with one:
`{"run": {...}}` forks a run and gives its `pid`; `{"reap": pid}` waits for it and gives its `code` (minus the signal).
The tests' side is `Forks`.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


class Forks:
    """The parent of the runs, seen from the tests."""

    def __enter__(self) -> Forks:
        environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'drivers'}"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.engine.forked"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=environment,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()

    def ask(self, job: Mapping[str, Any]) -> dict[str, Any]:
        """One job."""
        self._process.stdin.write(json.dumps(job) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def run(self, **job: Any) -> int:
        """Begin a run; its process."""
        return self.ask({"run": job})["pid"]

    def reap(self, pid: int) -> int:
        """Wait for the end of a run; its exit code, or minus the signal that killed it."""
        return self.ask({"reap": pid})["code"]


def main() -> None:
    """Serve jobs until standard input ends."""
    import pmabench.store.writer  # noqa: F401
    from pmabench.engine.run import run_plan  # noqa: F401
    from tests.engine.benches import mounted

    mount = mounted("mock-realtime")
    for line in sys.stdin:
        job = json.loads(line)
        if "reap" in job:
            _, status = os.waitpid(job["reap"], 0)
            answer = {"code": os.waitstatus_to_exitcode(status)}
        else:
            pid = os.fork()
            if pid == 0:
                os._exit(_child(job["run"], mount))
            answer = {"pid": pid}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


class _Hands:
    """Confirms every prompt, unless it is told to think for ever; may raise at a moment."""

    def __init__(self, job: Mapping[str, Any]) -> None:
        self._job = job

    def ask(self, text: str, measured: Mapping[str, float], wait: Any) -> str:
        while self._job.get("thinks"):
            wait()
        return "confirmed beforehand (--yes)"

    def poll(self, measured: Mapping[str, float]) -> tuple[()]:
        flag = self._job.get("raises")
        if flag and Path(flag).exists():
            raise ZeroDivisionError("seeded by the test")
        return ()


def _child(job: Mapping[str, Any], mount: Any) -> int:
    from pmabench.base.errors import PmaError, RecordError
    from pmabench.bench.interface import CompiledBench
    from pmabench.engine.run import run_plan
    from pmabench.store import writer
    from tests.engine.realtime_rig import plan_of

    os.setsid()
    os.environ["PMABENCH_STATE"] = job["state"]
    os.chdir(job.get("cwd", "."))
    reported = os.open(job["reported"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(reported, 1)
    os.dup2(reported, 2)
    if "fails" in job:
        whole = writer.RunWriter.append

        def append(self: Any, *data: Any) -> None:
            if Path(job["fails"]).exists():
                raise RecordError("seeded by the test: the record cannot be written")
            whole(self, *data)

        writer.RunWriter.append = append

    def say(**what: Any) -> None:
        os.write(reported, json.dumps({"t": time.monotonic(), **what}).encode() + b"\n")

    bench = replace(mount, bench=CompiledBench.from_json(json.dumps(job["bench"])))
    try:
        outcome = run_plan(
            plan_of(job["kind"]),
            bench,
            _Hands(job),
            out=Path(job["out"]),
            progress=lambda progress: say(step=progress.step),
            begun=lambda folder: say(folder=str(folder)),
        )
    except PmaError as error:
        say(error=str(error))
        return error.exit_code
    say(status=outcome.status, why=outcome.why, vent=outcome.vent.result if outcome.vent else None)
    return outcome.exit_code


def limit_file_size(pid: int, size: int) -> None:
    """No file of a process may grow beyond `size` [bytes] from now on."""
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, size))


if __name__ == "__main__":
    main()
