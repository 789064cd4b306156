"""A regulator and a run of `pmabench` as processes, and what the regulator's log says of them.

Nothing of the project is imported: it is a program like any other here, and the regulator's log is the judge.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.ports import free_port

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PATIENCE = 30.0
"""How long something that must happen is waited for [s], on a machine that has much else to do."""
PORTS_TRIED = 5
"""A port that was free may be another program's when the regulator opens it."""
MARK = "PMABENCH_OUTSIDE_RUN"
"""In the environment of a run and of its guard: which of them it is."""


def eventually(what: Callable[[], Any], within: float = PATIENCE, so: str = "it") -> Any:
    """What `what` gives as soon as it is true."""
    end = time.monotonic() + within
    while not (found := what()):
        assert time.monotonic() < end, f"{so}: not within {within:g} s"
        time.sleep(0.01)
    return found


def json_lines(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a file."""
    text = path.read_text() if path.exists() else ""
    return [json.loads(line) for line in text.split("\n")[:-1]]


class NotBegun(AssertionError):
    """A run ended before there was a pressure: nothing was tried."""


def once_begun(trial: Callable[[Path], Any], folder: Path) -> Any:
    """What a trial gives; one that did not come to its fault on a busy machine is begun again, twice at most."""
    for attempt in range(2):
        try:
            return trial(folder / f"attempt-{attempt}")
        except NotBegun as error:
            print(error)
    return trial(folder / "attempt-2")


class Regulator:
    """The regulator's process, its log and the socket that faults are sent to."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for _ in range(PORTS_TRIED):
            self.port, self.other_port, control = free_port(), free_port(), free_port()
            self.log = folder / f"regulator-{self.port}.jsonl"
            command = [sys.executable, "-I", str(HERE / "regulator.py")]
            command += ["--port", str(self.port), "--port", str(self.other_port), "--serial", str(self.port)]
            command += ["--control", str(control), "--log", str(self.log)]
            self._process = subprocess.Popen(command)
            eventually(lambda: self.lines("serve") or self._process.poll(), so="the regulator serves")
            if self._process.poll() is None:
                break
        self._link = socket.create_connection(("127.0.0.1", control), timeout=PATIENCE)
        self._answers = self._link.makefile()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, **what: Any) -> dict[str, Any]:
        """A question to the device itself, past Modbus."""
        self._link.sendall(json.dumps(what).encode() + b"\n")
        answer: dict[str, Any] = json.loads(self._answers.readline())
        assert "error" not in answer, answer
        return answer

    def inject(self, fault: str, value: float = 0.0) -> float:
        """Let a fault happen; when it did [s, monotonic]."""
        self.ask(fault=fault, value=value)
        return float(self.lines("fault")[-1]["t"])

    def clear(self) -> None:
        """Every lasting fault is over."""
        self.ask(clear=True)

    def state(self) -> dict[str, Any]:
        """The truth about registers and air."""
        return self.ask()

    def lines(self, *kinds: str, since: float = 0.0) -> list[dict[str, Any]]:
        """The log, in the order of its times."""
        found = [line for line in json_lines(self.log) if line["t"] >= since and (not kinds or line["do"] in kinds)]
        return sorted(found, key=lambda line: line["t"])

    def close(self) -> None:
        """Switch it off."""
        self._process.kill()
        self._process.wait()
        self._answers.close()
        self._link.close()


@contextmanager
def regulator(folder: Path) -> Iterator[Regulator]:
    """A regulator for as long as the block lasts."""
    made = Regulator(folder)
    try:
        yield made
    finally:
        made.close()


def write_bench(folder: Path, name: str, address: str, *, watched: bool = False) -> Path:
    """The bench file of tests/outside with a name and an address, and what it refers to.

    `watched`: with its limits on a pressure that does not follow, or does not change; these would hide whether the
    state of the device is supervised.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for file in [*HERE.glob("*.yaml"), *HERE.glob("calibrations/*.yaml")]:
        to = folder / file.relative_to(HERE)
        to.parent.mkdir(exist_ok=True)
        text = file.read_text("utf-8")
        if file.name == "bench.yaml":
            text = text.replace("NAME", json.dumps(name, ensure_ascii=False)).replace("ADDRESS", address)
            text = "".join(line for line in text.splitlines(keepends=True) if watched or "# watched" not in line)
        to.write_text(text, "utf-8")
    return folder / "bench.yaml"


def environment(state: Path) -> dict[str, str]:
    """Of a `pmabench` with its state in a folder of the test."""
    return {**os.environ, "PMABENCH_STATE": str(state), "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'drivers'}"}


def pmabench(state: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """A command of `pmabench`, waited for."""
    command = [sys.executable, "-P", "-m", "pmabench", *map(str, arguments)]
    return subprocess.run(command, env=environment(state), capture_output=True, text=True, check=False, timeout=120)


def _environment_of(pid: int) -> bytes:
    with suppress(OSError):
        return Path(f"/proc/{pid}/environ").read_bytes()
    return b""


class Run:
    """`pmabench run` on a bench file, as a process; `prefix` are the words of a program that starts it."""

    def __init__(
        self,
        bench: Path,
        protocol: str,
        state: Path,
        device: Regulator | None = None,
        prefix: tuple[str, ...] = (),
    ) -> None:
        self.device, self.state, self.folder = device, state, bench.parent
        self.out = self.folder / f"runs-{time.monotonic_ns()}"
        command = [*prefix, sys.executable, "-P", "-m", "pmabench", "run", str(bench.parent / f"{protocol}.yaml")]
        command += ["--bench", str(bench), "--specimen", str(bench.parent / "specimen.yaml")]
        command += ["--out", str(self.out), "--yes", "--json"]
        self.began = time.monotonic()
        self.process = subprocess.Popen(
            command,
            env={**environment(state), MARK: str(self.out)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._said: tuple[str, str] | None = None

    def guards(self) -> list[dict[str, Any]]:
        """What the state folder says of guards of this run that live: port, process, secret."""
        found = [json.loads(path.read_text()) for path in self.state.glob("*/guard.json")]
        return [one for one in found if f"{MARK}={self.out}".encode() in _environment_of(one["pid"])]

    @property
    def guard(self) -> dict[str, Any]:
        """The guard of this run."""
        return self.guards()[0]

    @property
    def record(self) -> Path:
        """Its run folder."""
        return next(self.out.glob("*/manifest.json")).parent

    def pressurised(self, above: float = 60.0) -> None:
        """Wait until the proof is over and the muscle is under pressure [kPa]."""
        device = self.device
        assert device is not None

        def now() -> bool:
            if self.process.poll() is not None:
                raise NotBegun(f"the run ended before it pressurised: {self.said()}")
            state = device.state()
            return bool(state["pressure"] > above)

        eventually(now, so="the muscle is under pressure")

    def stop(self, *who: str) -> None:
        """SIGSTOP of engine, guard or both."""
        for name in who:
            os.kill(self.pid(name), signal.SIGSTOP)

    def go_on(self, *who: str) -> None:
        """SIGCONT."""
        for name in who:
            os.kill(self.pid(name), signal.SIGCONT)

    def pid(self, name: str) -> int:
        """Process of the engine or of the guard; asked for as long as both live."""
        return self.process.pid if name == "engine" else int(self.guard["pid"])

    def said(self, within: float = PATIENCE) -> tuple[str, str]:
        """Standard output and error, when it has ended."""
        if self._said is None:
            self._said = self.process.communicate(timeout=within)
        return self._said

    def end(self, within: float = PATIENCE) -> dict[str, Any]:
        """Its outcome: the object of `--json` with `exit_code`; what it said otherwise under `why`."""
        out, err = self.said(within)
        try:
            reported = json.loads(out)
        except ValueError:
            reported = {}
        return {"status": "none", "why": f"{out}{err}", **reported, "exit_code": self.process.returncode}

    def kill(self, *who: str) -> None:
        """SIGKILL; all that is left where nobody is named."""
        pids: Iterable[int] = [self.pid(name) for name in who]
        if not who:
            pids = [self.process.pid, *(one["pid"] for one in self.guards())]
        for pid in pids:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        if not who or "engine" in who:
            self.said()


@contextmanager
def run(device: Regulator, folder: Path, protocol: str = "holds", *, watched: bool = False) -> Iterator[Run]:
    """A run under way on a bench of its own, killed when the block ends."""
    bench = write_bench(folder / "bench", "outside", device.address, watched=watched)
    made = Run(bench, protocol, folder / "state", device)
    try:
        yield made
    finally:
        made.kill()


def random_instant(seed: str, longest: float = 2.0) -> float:
    """A time that is the same at every run of the tests [s]."""
    return random.Random(seed).uniform(0.0, longest)
