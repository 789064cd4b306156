"""Whole sine runs over CAN and a serial line, in real time: two devices, two clocks."""

import pytest

from tests.drivers.festo_cmmt.test_run import dying, pooled, sines
from tests.drivers.judged import SLACK, WHO, assert_vented
from tests.drivers.whole_run import WholeRun, until

pytestmark = pytest.mark.realtime


def sure(estimate):
    """Whether there is an estimate with an interval that says something."""
    if estimate is None or not estimate["ci95"]:
        return False
    low, high = estimate["ci95"]
    return high - low < 0.2 * estimate["value"]


@pytest.mark.slow
def test_coefficients_come_back(tmp_path):
    with WholeRun(tmp_path, "can", preset="bench") as run:
        for _ in range(3):
            run.carried_out(sines(0.5, 1))
            assert_vented(run)
            moved = [entry["si"] for entry in run.entries("move")]
            assert max(moved) <= 15.001e-3
            assert min(moved) >= 0.0
            table = run.stream("bus")
            assert table["displacement"].max() - 5000 == pytest.approx(15_000, abs=200)  # um, its zero 5 mm lower
            found = pooled(run)
            if all(sure(found.get(symbol)) for symbol in ("K", "B")):
                break
            assert "flagged GAP" in run.said  # the machine has lost too many samples to say anything
        assert all(sure(found.get(symbol)) for symbol in ("K", "B")), run.said
        # reference plant 5.1 at 300 kPa: K = 5.6 + 1e-3 P + 9.7e-6 P^2, B the mean of 1.2 + 1.6e-3 P and 1.1 + 3.4e-3 P
        true = {"K": 6773.0, "B": 1900.0}
        for symbol in ("K", "B"):
            value, (low, high) = found[symbol]["value"], found[symbol]["ci95"]
            print(f"{symbol}: {value:.5g} for {true[symbol]:.5g}, {low:.5g} to {high:.5g}", found[symbol]["parts"])
        assert found["K"]["value"] == pytest.approx(true["K"], rel=0.02)
        low, high = found["B"]["ci95"]
        assert low <= true["B"] <= high
        assert high - low <= 0.1 * true["B"]
        assert found["F_c"]["value"] == pytest.approx(6.0, abs=2.0)
        assert found["F_ce"]["value"] == pytest.approx(275.0, rel=0.02)  # 1.08 P - 49


def stopped_after(run, moment, within):
    """The drive stands and the bench is vented within a time of a moment [s], and both stay so."""

    def stands():
        return [e for kind in ("halt", "watchdog") for e in run.entries(kind) if e["t"] >= moment]

    assert until(lambda: [e for e in stands() if e["device"] == "bus"], within + SLACK)
    first = min(e["t"] for e in stands() if e["device"] == "bus")
    took, entry = run.vented_after(moment)
    print(f"drive stopped after {1e3 * (first - moment):.0f} ms, {entry['kind']} after {1e3 * took:.0f} ms")
    assert max(first - moment, took) < within + SLACK
    until(lambda: False, 0.5)
    assert not [e for e in run.entries("move") if e["t"] > first + 0.05]


@pytest.mark.parametrize(
    "who",
    [who if who == "all killed" else pytest.param(who, marks=pytest.mark.slow) for who in WHO if who != "all frozen"],
)
def test_whoever_dies_the_drive_stops_and_the_muscle_is_vented(tmp_path, who):
    process, number, promised = WHO[who]
    with WholeRun(tmp_path, "can") as run:
        moment = dying(run, lambda run: run.signal(process, number))
        stopped_after(run, moment, max(promised, 0.5))
        if who == "all killed":  # the drive by its heartbeat, the board by its watchdog
            assert {e["device"] for e in run.entries("watchdog")} == {"bus", "board"}


@pytest.mark.slow
def test_the_emergency_stop_stops_the_drive(tmp_path):
    with WholeRun(tmp_path, "can") as run:
        stopped_after(run, dying(run, lambda run: run.ask(plant="e_stop")), 0.2)
        assert "e-stop" in run.failed(code=5)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["hang-up", "silence", "emergency", "restart", "watchdog"])
def test_what_goes_wrong_on_the_bus_ends_the_run(tmp_path, fault):
    with WholeRun(tmp_path, "can") as run:
        stopped_after(run, dying(run, lambda run: run.ask(device="bus", fault=fault)), 0.5)
        assert "bus" in run.failed()


@pytest.mark.slow
def test_with_the_board_dead_the_drive_stops(tmp_path):
    with WholeRun(tmp_path, "can") as run:
        stopped_after(run, dying(run, lambda run: run.ask(device="board", fault="silence")), 0.5)
        assert "board" in run.failed()
