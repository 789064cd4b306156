"""Engine and guard that stand still together, are killed together, or a guard that goes on after its run was sealed."""

from __future__ import annotations

import json
import random
import time
from pathlib import Path

from tests.outside.campaign import ENDS_WITHIN, Result, safe_lines
from tests.outside.harness import Regulator, Run, eventually, pmabench, random_instant, regulator, run
from tests.outside.kinds import ALL, WATCHDOG

LENGTHS = (0.3, 0.9, 2.0, 10.0)
"""How long both stand still [s]."""
VENTS_WITHIN = 1.0
"""From the end of the freeze to the first command of the safe state [s]."""
PENDING = 0.05
"""The engine lives for so long longer than the guard, so that a message of it waits in the guard's socket [s]."""


def freeze(length: float, number: int, folder: Path, *, pending: bool = False) -> Result:
    """Stop both at a random instant for `length` [s], and let them go on, in any order."""
    name = f"freeze {length:g} s{' with a message' if pending else ''}"
    protocol = ALL[number % len(ALL)]
    result = Result(name, protocol)
    chance = random.Random(f"{name} {number}")
    with regulator(folder) as device, run(device, folder, protocol) as going:
        going.pressurised()
        time.sleep(chance.uniform(0.0, 2.0))
        going.pressurised(40.0)
        both = ["guard", "engine"] if pending else chance.sample(["guard", "engine"], 2)
        going.stop(both[0])
        if pending:
            time.sleep(PENDING)
        going.stop(both[1])
        began = time.monotonic()
        time.sleep(length)
        over = time.monotonic()
        going.go_on(*chance.sample(both, 2))
        _must_end(result, device, going, began, over)
        if length > 2 * WATCHDOG and result.by != "watchdog":
            result.wrong.append("the device's watchdog did not end during the freeze: the test has not tested anything")
        if result.by == "watchdog" and not result.wrong and "watchdog" not in _reported(going.record):
            result.wrong.append("the record does not say that the device's watchdog had ended")
    return result


def _must_end(result: Result, device: Regulator, going: Run, began: float, over: float) -> None:
    """Nothing is pressurised after the freeze, the guard vents at once, and the run ends as one that did not finish."""
    try:
        outcome = going.end(ENDS_WITHIN)
    except Exception as error:
        outcome = {"why": f"does not end: {type(error).__name__}", "exit_code": 0, "status": "none"}
        result.wrong.append(f"the run did not end within {ENDS_WITHIN:g} s")
    result.why = str(outcome["why"])
    ended = [line for line in device.lines("watchdog", since=began) if line["t"] < over + WATCHDOG]
    result.by = "watchdog" if ended and ended[0]["t"] < over else "guard"
    safe = [line for line in safe_lines(device, over) if line["do"] == "write"]
    vented = device.lines("vented", since=began)
    if safe:
        result.noticed = safe[0]["t"] - over
    if vented:
        result.vented = max(vented[0]["t"] - over, 0.0)
    if result.noticed > VENTS_WITHIN:
        result.wrong.append(f"the guard vented {result.noticed:.2f} s after the freeze, not {VENTS_WITHIN:g} s")
    first = safe[0]["t"] if safe else over
    sets = [line for line in device.lines("write", since=over) if line["register"] == 10 and line["value"]]
    after = [line for line in sets if line["done"] and line["t"] > first]
    # one write that was on its way to the device when both were stopped cannot be taken back: the vent follows it
    if len(sets) - len(after) > 1:
        after = sets
    if after:
        result.wrong.append(f"set-point {after[0]['value']} {after[0]['t'] - over:.2f} s after the freeze")
    if ended and device.lines("pressurised", since=over):
        result.wrong.append("pressurised again after the device's watchdog had ended")
    state = device.state()
    if state["pressure"] > 20.0:
        result.by = "nobody"
        result.wrong.append(f"{state['pressure']:.0f} kPa at the end")
    if outcome["exit_code"] == 0 or outcome["status"] in {"finished", "none"}:
        result.wrong.append(f"exit code {outcome['exit_code']}, status {outcome['status']}")


def _reported(record: Path) -> str:
    """What the record says of how the run went; the files that say what the bench is are left out."""
    files = [
        path for path in record.iterdir() if path.suffix in {".json", ".jsonl"} and path.stem not in {"bench", "plan"}
    ]
    return "".join(path.read_text("utf-8") for path in files)


def kill_both(number: int, folder: Path) -> Result:
    """SIGKILL of engine and guard: the device's watchdog is what is left."""
    result = Result("kill -9 of both", ALL[number % len(ALL)])
    with regulator(folder) as device, run(device, folder, result.protocol) as going:
        going.pressurised()
        time.sleep(random_instant(f"kill {number}"))
        going.pressurised(40.0)
        moment = time.monotonic()
        going.kill("guard", "engine")
        ended = eventually(lambda: device.lines("watchdog", since=moment), 5.0, "the watchdog ends")
        vented = eventually(lambda: device.lines("vented", since=moment), 5.0, "the muscle is empty")
        result.by, result.why = "watchdog", "killed"
        result.noticed, result.vented = ended[0]["t"] - moment, vented[-1]["t"] - moment
        if result.noticed > WATCHDOG + 0.3:
            result.wrong.append(f"the watchdog ended {result.noticed:.2f} s after the kill")
        time.sleep(0.5)
        if device.lines("write", since=vented[-1]["t"]) or device.state()["pressure"] > 20.0:
            result.wrong.append("something was commanded after the kill")
    return result


def seal(number: int, folder: Path) -> Result:
    """Stop the guard at a random instant: the engine ends it, and seals the run; the record stays whole."""
    result = Result("guard around the seal", ALL[number % len(ALL)])
    with regulator(folder) as device, run(device, folder, result.protocol) as going:
        going.pressurised()
        time.sleep(random_instant(f"seal {number}"))
        going.pressurised(40.0)
        guard = going.pid("guard")
        moment = time.monotonic()
        going.stop("guard")
        outcome = going.end()
        result.why = str(outcome["why"])
        safe = safe_lines(device, moment)
        result.by = "watchdog" if safe and safe[0]["do"] == "watchdog" else "guard" if safe else "nobody"
        result.noticed = safe[0]["t"] - moment if safe else float("inf")
        result.vented = device.lines("vented", since=moment)[0]["t"] - moment
        before = {path.name: path.read_bytes() for path in going.record.iterdir() if path.is_file()}
        if Path(f"/proc/{guard}").exists():
            result.wrong.append("the stopped guard is still there, and may go on")
        for name, data in before.items():
            if (going.record / name).read_bytes() != data:
                result.wrong.append(f"{name} was written after the seal")
        whole = pmabench(going.state, "runs", "verify", going.record)
        if whole.returncode != 0 or "whole" not in whole.stdout:
            result.wrong.append(f"verify: {whole.returncode}: {whole.stdout}{whole.stderr}")
        for command, codes in ((["runs", "show"], {0}), (["process"], {0, 6})):
            done = pmabench(going.state, *command, going.record)
            if done.returncode not in codes or "damaged" in done.stdout + done.stderr:
                result.wrong.append(f"{' '.join(command)}: {done.returncode}: {done.stdout}{done.stderr}")
        listed = pmabench(going.state, "runs", "list", "--json", going.out)
        if listed.returncode or going.record.name not in listed.stdout:
            result.wrong.append(f"runs list: {listed.returncode}: {listed.stdout}{listed.stderr}")
        state = json.loads(next(going.state.glob("*/state.json")).read_text())
        if state.get("what") != "tripped":
            result.wrong.append(f"after a lost guard the bench is not latched: {state}")
    return result
