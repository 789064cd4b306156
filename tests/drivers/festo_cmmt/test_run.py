"""Whole sine runs through drive and terminal, in real time: two devices, two clocks."""

import json
import subprocess
import sys
import time

import pytest

from tests.drivers.judged import SLACK, WHO, assert_vented
from tests.drivers.whole_run import LONGEST, TRIES, WholeRun, until

pytestmark = pytest.mark.realtime

SINES = """\
schema: pmabench.protocol/1
kind: sinusoidal-displacement
name: sines at one pressure
source: made for this test
needs: {free_end: actuator}
sample_rate: 50 Hz
record: [pressure, displacement, force, pressure_command, displacement_command]
prepare: {precondition: {cycles: 1, pressure: 300 kPa, hold: 500 ms}}
sweep: {matrix: {pressure: [300 kPa], frequency: FREQUENCIES}, order: as-written, repeat: {count: 3, as: blocks}}
trial: {mean: 10 mm, amplitude: 5 mm, cycles: 6, at_least: 6 s, discard: 1, settle: 1 s, approach: 20 mm/s}
"""


def sines(*frequencies):
    return SINES.replace("FREQUENCIES", f"[{', '.join(f'{f:g} Hz' for f in frequencies)}]")


def pooled(run):
    """Symbol -> estimate at 300 kPa from all frequencies, as `pmabench process` gives it."""
    command = [sys.executable, "-m", "pmabench", "process", str(run.record), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    assert done.returncode in {0, 6}, done.stderr
    [analysis] = json.loads(done.stdout)["analyses"]
    return {
        e["symbol"]: e
        for e in analysis["estimates"]
        if e["method"] in {"sine-harmonic", "sine-mean"} and "frequency" not in e["at"] and not e["coordinate"]
    }


@pytest.mark.slow
def test_coefficients_come_back(tmp_path):
    with WholeRun(tmp_path, "festo-sine", preset="bench") as run:
        for _ in range(TRIES):
            run.carried_out(sines(0.5, 1, 2))
            assert_vented(run)
            found = pooled(run)
            if all(found.get(symbol, {}).get("ci95") for symbol in ("K", "B")) or "flagged GAP" not in run.said:
                break
            print("again, since a busy machine left gaps in too many trials")
        moved = [entry["si"] for entry in run.entries("move")]
        assert max(moved) <= 15.001e-3
        assert min(moved) >= 0.0
        # reference plant 5.1 at 300 kPa: K = 5.6 + 1e-3 P + 9.7e-6 P^2, B the mean of 1.2 + 1.6e-3 P and 1.1 + 3.4e-3 P
        true = {"K": 6773.0, "B": 1900.0}
        for symbol in ("K", "B"):
            value, (low, high) = found[symbol]["value"], found[symbol]["ci95"]
            print(f"{symbol}: {value:.5g} for {true[symbol]:.5g}, {low:.5g} to {high:.5g}", found[symbol]["parts"])
        assert found["K"]["value"] == pytest.approx(true["K"], rel=0.02)
        low, high = found["B"]["ci95"]
        assert low <= true["B"] <= high
        assert high - low <= 0.1 * true["B"]
        assert found["B"]["parts"]["skew"] > 0
        assert found["F_c"]["value"] == pytest.approx(6.0, abs=1.5)
        assert found["F_ce"]["value"] == pytest.approx(275.0, rel=0.02)  # 1.08 P - 49


def dying(run, act):
    """Under pressure and in motion `act` happens: the time when."""
    for _ in range(3):
        run.pressurised(sines(0.5))
        if until(lambda: run.over or len(run.entries("move")) > 100, 60) and not run.over:
            break
    assert not run.over, run.said
    moment = time.monotonic()
    act(run)
    return moment


def stopped_after(run, moment, within):
    """The drive stands and the bench is vented within a time of a moment [s], and stays so."""

    def stands():
        return [e for kind in ("halt", "watchdog") for e in run.entries(kind) if e["t"] >= moment]

    assert until(lambda: [e for e in stands() if e["device"] == "drive"], within + SLACK)
    first = min(e["t"] for e in stands() if e["device"] == "drive")
    took, entry = run.vented_after(moment)
    print(f"drive stopped after {1e3 * (first - moment):.0f} ms, {entry['kind']} after {1e3 * took:.0f} ms")
    assert max(first - moment, took) < within + SLACK
    time.sleep(0.5)
    assert not [e for e in run.entries("move") if e["t"] > first + 0.05]


@pytest.mark.parametrize(
    "who",
    [who if who == "all killed" else pytest.param(who, marks=pytest.mark.slow) for who in WHO if who != "all frozen"],
)
def test_whoever_dies_the_drive_stops_and_the_muscle_is_vented(tmp_path, who):
    process, number, promised = WHO[who]
    with WholeRun(tmp_path, "festo-sine") as run:
        moment = dying(run, lambda run: run.signal(process, number))
        stopped_after(run, moment, max(promised, 0.5))
        if who == "all killed":
            assert {e["device"] for e in run.entries("watchdog")} == {"drive", "terminal"}


@pytest.mark.slow
def test_the_emergency_stop_stops_the_drive(tmp_path):
    with WholeRun(tmp_path, "festo-sine") as run:
        stopped_after(run, dying(run, lambda run: run.ask(plant="e_stop")), 0.2)
        assert "e-stop" in run.failed(code=5)


@pytest.mark.slow
@pytest.mark.parametrize("device", ["drive", "terminal"])
def test_a_device_that_says_nothing_stops_by_itself(tmp_path, device):
    with WholeRun(tmp_path, "festo-sine") as run:
        stopped_after(run, dying(run, lambda run: run.ask(device=device, fault="silence")), 0.5)
        assert device in run.failed()


@pytest.mark.slow
def test_a_fault_of_the_drive_ends_the_run(tmp_path):
    with WholeRun(tmp_path, "festo-sine") as run:
        moment = dying(run, lambda run: run.ask(device="drive", fault="watchdog"))
        stopped_after(run, moment, 0.5)
        assert "reports fault" in run.failed()
