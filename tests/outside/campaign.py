"""Faults of the regulator at random instants of a run, judged by the regulator's own log.

`python -m tests.outside.campaign [--each N] [--kinds NAME,NAME] [--workers N]` prints one table: kind, how many, who
vented, median and longest time from the cause to the safe command and to a muscle without pressure, and a reason.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import statistics
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from tests.outside.harness import Regulator, Run, eventually, once_begun, random_instant, regulator, run
from tests.outside.kinds import KINDS, WATCHDOG, Kind

EMPTY_WITHIN = 1.0
"""From the safe command to a muscle without pressure; its time constants are 0.05 s and 0.08 s [s]."""
ENDS_WITHIN = 12.0
"""A run that was vented is over and sealed within so long [s]; the vent itself is judged by the device's log."""
LOOKED_AT = 2.5
"""A run that may survive a fault is looked at for so long [s]."""


@dataclass
class Result:
    """What came of one fault."""

    kind: str
    protocol: str
    by: str = "nobody"
    """Who vented: `guard`, `watchdog` (the device's), `fault` (it vents by itself), `alive` (the run goes on)."""
    noticed: float = float("inf")
    vented: float = float("inf")
    why: str = ""
    wrong: list[str] = field(default_factory=list)


def try_once(kind: Kind, number: int, folder: Path) -> Result:
    """One run, one fault, one verdict."""
    seed = f"{kind.name} {kind.then_ended} {number}"
    protocol = kind.protocols[number % len(kind.protocols)]
    result = Result(kind.name, protocol)
    with regulator(folder) as device, run(device, folder, protocol, watched=kind.watched) as going:
        going.pressurised()
        time.sleep(random_instant(seed))
        going.pressurised(40.0)
        moment = device.inject(kind.name, kind.value)
        if kind.then_ended:
            time.sleep(0.3)
            going.process.send_signal(signal.SIGTERM)
        if kind.survivable:
            time.sleep(LOOKED_AT)
            if not safe_lines(device, moment) and going.process.poll() is None:
                _survived(result, device, going)
                return result
        _ended(result, kind, device, going, moment)
    return result


def safe_lines(device: Regulator, since: float) -> list[dict[str, Any]]:
    """What asks for a muscle without pressure: an opened dump valve, done or ignored, or the device's watchdog."""
    return [
        line
        for line in device.lines("write", "watchdog", since=since)
        if line["do"] == "watchdog" or (line["register"] == "coil" and not line["value"])
    ]


def _ended(result: Result, kind: Kind, device: Regulator, going: Run, moment: float) -> None:
    """The run must have ended with a muscle without pressure."""
    try:
        outcome = going.end(ENDS_WITHIN)
    except Exception as error:
        outcome = {"why": f"does not end: {type(error).__name__}", "exit_code": 0, "status": "none"}
        result.wrong.append(f"the run did not end within {ENDS_WITHIN:g} s")
    time.sleep(2 * WATCHDOG)
    state = device.state()
    cause = moment
    if kind.cause == "ignored":
        ignored = [line["t"] for line in device.lines("write", since=moment) if not line["done"]]
        if not ignored:
            result.wrong.append("no write was ignored: the test has not tested anything")
            return
        cause = ignored[0]
    safe = safe_lines(device, cause)
    vented = [line["t"] for line in device.lines("vented", since=moment)]
    starved = sum(line["lasted"] for line in device.lines("starved", since=moment))
    result.why = str(outcome["why"])
    if safe:
        result.noticed = safe[0]["t"] - cause
    if vented:
        result.vented = max(vented[0] - cause, 0.0)
        done = [line for line in safe if line["do"] == "watchdog" or line["done"]]
        zeros = [
            line
            for line in device.lines("write", since=cause)
            if line["register"] == 10 and line["value"] == 0 and line["done"]
        ]
        first = min((line["t"] for line in [*done, *zeros]), default=float("inf"))
        by = next((line["do"] for line in done if line["t"] == first), "write")
        result.by = "fault" if vented[0] < first else "watchdog" if by == "watchdog" else "guard"
        after = device.lines("pressurised", since=max(vented[0], cause + kind.noticed))
        if after:
            result.wrong.append(f"pressurised again {after[0]['t'] - cause:.2f} s after the cause")
    limit = kind.noticed + starved
    if result.noticed > limit:
        result.wrong.append(f"noticed after {result.noticed:.2f} s, not {kind.noticed:g} s")
    if result.by != "fault" and result.vented > limit + WATCHDOG + EMPTY_WITHIN:
        result.wrong.append(f"without pressure after {result.vented:.2f} s")
    if state["pressure"] > 20.0:
        result.by = "nobody"
        result.wrong.append(f"{state['pressure']:.0f} kPa at the end")
    if outcome["exit_code"] == 0 or outcome.get("status") in {"finished", "none"}:
        result.wrong.append(f"exit code {outcome['exit_code']}, status {outcome.get('status')}")
    if not re.search(kind.reason, result.why, re.IGNORECASE):
        result.wrong.append(f"the reason does not name it: {result.why}")
    latch = json.loads(next(going.state.glob("*/state.json")).read_text())
    if kind.latches and latch["what"] != "tripped":
        vent = f"{outcome.get('vent')}; valve: {device.lines('write', since=moment)}"
        result.wrong.append(f"an action of the vent failed, and the bench is {latch['what']}, not tripped: {vent}")
    if kind.name in SUPERVISED and "regulator" not in result.why:
        result.wrong.append(f"the reason does not name the device: {result.why}")


SUPERVISED = {"restart", "restart-valve-kept", "watchdog-off", "watchdog-time", "set-point", "set-point-zero",
              "serial", "watchdog-ends"}  # fmt: skip
"""Kinds whose reason must name the device."""


def _survived(result: Result, device: Regulator, going: Run) -> None:
    """A run that goes on still feeds an armed watchdog, and can still vent."""
    state = device.state()
    result.by, result.why = "alive", "the run went on"
    if state["watchdog"] != WATCHDOG or state["t"] - state["fed"] > WATCHDOG / 2:
        result.wrong.append(
            f"goes on with a watchdog of {state['watchdog']} s, fed {state['t'] - state['fed']:.2f} s ago"
        )
    moment = time.monotonic()
    going.process.send_signal(signal.SIGTERM)
    safe = eventually(lambda: safe_lines(device, moment), so="SIGTERM vents")
    eventually(lambda: device.state()["pressure"] < 20.0, so="SIGTERM vents")
    result.noticed = safe[0]["t"] - moment
    result.vented = device.lines("vented")[-1]["t"] - moment
    if result.noticed > 1.0:
        result.wrong.append(f"SIGTERM vented after {result.noticed:.2f} s")


def _numbers(kind: Kind, each: int | None) -> list[int]:
    """Instants; a kind that is tried once is not always tried on the same protocol."""
    return [len(kind.name)] if each == 1 else list(range(kind.each if each is None else each))


def campaign(each: int | None, names: set[str], workers: int, folder: Path) -> list[Result]:
    """Every kind, `each` times (None: as its row says), some side by side."""
    jobs = [(kind, number) for kind in KINDS if not names or kind.name in names for number in _numbers(kind, each)]

    def one(job: tuple[int, tuple[Kind, int]]) -> Result:
        index, (kind, number) = job
        try:
            found: Result = once_begun(partial(try_once, kind, number), folder / f"{index:04}-{kind.name}")
            return found
        except Exception as error:
            return Result(kind.name, kind.protocols[0], wrong=[f"{type(error).__name__}: {error}"])

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, enumerate(jobs)))


def table(results: list[Result]) -> str:
    """One line per kind."""
    lines = [f"{'kind':24} {'n':>3} {'guard':>5} {'w.dog':>5} {'fault':>5} {'alive':>5} {'not':>3} "
             f"{'noticed [s]':>15} {'empty [s]':>15} {'wrong':>5}  reason"]  # fmt: skip
    for name in dict.fromkeys(result.kind for result in results):
        some = [result for result in results if result.kind == name]
        by = [sum(result.by == who for result in some) for who in ("guard", "watchdog", "fault", "alive", "nobody")]
        wrong = sum(bool(result.wrong) for result in some)
        times = [_times([getattr(result, of) for result in some]) for of in ("noticed", "vented")]
        lines.append(
            f"{name:24} {len(some):3} {by[0]:5} {by[1]:5} {by[2]:5} {by[3]:5} {by[4]:3} "
            f"{times[0]:>15} {times[1]:>15} {wrong:5}  {some[0].why[:110]}"
        )
    lines += [f"  {r.kind} ({r.protocol}): {'; '.join(r.wrong)}" for r in results if r.wrong]
    return "\n".join(lines)


def _times(values: list[float]) -> str:
    known = [value for value in values if value != float("inf")]
    return f"{statistics.median(known):6.3f} {max(values):7.3f}" if known else "-"


def main() -> int:
    """Exit code 1 where anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, help="instants for each kind; without it as the table of kinds says")
    parser.add_argument("--kinds", default="", help="names with commas; all without it")
    parser.add_argument("--workers", type=int, default=2, help="runs side by side")
    given = parser.parse_args()
    names = {name for name in given.kinds.split(",") if name}
    with tempfile.TemporaryDirectory() as folder:
        results = campaign(given.each, names, given.workers, Path(folder))
    print(table(results))
    return int(any(result.wrong for result in results))


if __name__ == "__main__":
    sys.exit(main())
