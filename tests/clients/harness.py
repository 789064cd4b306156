"""Runs a client's script in front of the emulator of its device, and compares what the client saw with the plant."""

import ast
import json
import os
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

from pmabench_drivers.emulator import Emulator

FOLDER = Path(__file__).parent
WITHIN = 120.0
"""Longest time of a script [s]."""
NEAR = {"pressure": 2e3, "displacement": 1e-3, "force": 5.0, "commanded": 0.5e3, "valve": 0.0}
"""What a client may see, and how far it may be off: [Pa], [m], [N]; the set-point [Pa]; 1 where the valve is energised."""
AGREES, DISAGREES, NOT_TRIED = "agrees", "disagrees", "not tried"


@dataclass(frozen=True)
class Result:
    """What came of one call."""

    call: str
    state: str
    why: str = ""


def calls_of(script):
    """The calls that a script makes, in their order: the texts of its `call(...)` and `not_tried(...)`."""
    tree = ast.parse((FOLDER / script).read_text("utf-8"))
    found = [
        (node.lineno, str(node.args[0].value))
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in {"call", "not_tried"}
        and isinstance(node.args[0], ast.Constant)
    ]
    return [name for _line, name in sorted(found)]


def environment(client, folder):
    """The Python that a client runs with: the project's own, or that of an environment made for its package alone."""
    if not client.package:
        return sys.executable
    place = folder / client.name.replace(" ", "-")
    python = place / "bin" / "python"
    if not python.exists():
        venv.create(place, with_pip=True)
        done = subprocess.run(
            [python, "-m", "pip", "install", "-q", *client.package.split()], capture_output=True, text=True
        )
        if done.returncode:
            raise RuntimeError(f"pip install {client.package} failed: {done.stderr.strip()[-300:]}")
    return str(python)


def run(client, folder):
    """What came of every call of a client, in the script's order."""
    python = environment(client, folder)
    device = client.device(folder / "line")
    emulator = Emulator([device], preset="ideal")
    try:
        served = emulator.devices[device.name]
        addresses = client.addresses(served)
        command = [python, str(FOLDER / client.script), *map(str, addresses)]
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=clean) as process:
            try:
                results = [_judged(json.loads(text), emulator) for text in process.stdout]
                problem = process.stderr.read()
                process.wait(WITHIN)
            finally:
                process.kill()
    finally:
        emulator.close()
    done = [result.call for result in results]
    missing = [name for name in calls_of(client.script) if name not in done]
    last = problem.strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
    return [*results, *(Result(name, DISAGREES, f"the script ended before it: {last[0]}") for name in missing)]


def _judged(said, emulator):
    """A line of the script, with what the client saw held against the plant and the log of commands."""
    if said["ok"] is None:
        return Result(said["call"], NOT_TRIED, said["why"])
    wrong = [said["why"]] if not said["ok"] else []
    truth = emulator.plant.quantities() if said.get("saw") else {}
    for what, value in said.get("saw", {}).items():
        known = truth[what] if what in truth else _commanded(emulator, what)
        if not abs(value - known) <= NEAR[what]:
            wrong.append(f"the client saw {what} {value:g} and it is {known:g}")
    return Result(said["call"], DISAGREES if wrong else AGREES, "; ".join(wrong))


def _commanded(emulator, what):
    """The last set-point [Pa] or the last state of the valve on the wire."""
    if what == "commanded":
        return [entry["si"] for entry in emulator.log.of("set")][-1]
    return float([entry["on"] for entry in emulator.log.of("switch")][-1])
