"""Whole runs through the wires of every rig, in real time: coefficients come back, and whatever dies, the bench vents.

`RIGS` has a row for each rig with what it promises, and `DRIVEN` for those whose actuator holds the free end.
"""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from itertools import pairwise

import pytest

from pmabench.bench.compile import mount
from pmabench.files.shipped import shipped_folder
from tests.drivers.judged import (
    B_OF_POLLED,
    HARDWARE_TIMED,
    POLLED,
    SLACK,
    WHO,
    assert_dies,
    assert_gives_back,
    assert_vented,
    assert_vents,
    e_stop,
    lost,
)
from tests.drivers.sines import TRUE, dying, pooled, sines, stopped_after
from tests.drivers.whole_run import LONGEST, SPECIMEN, TRIES, WholeRun, coefficients, one_step

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]


def ni_alone():
    """Changes to the bench: no relay module, the dump valve on a line of the USB-6215 itself."""
    text = (shipped_folder("bench") / "ni.yaml").read_text()
    relay = text[text.index("  relay:") : text.index("channels:")]
    valve = "dump_valve: {device: relay, output: dump_valve,", "dump_valve: {device: daq, output: port1/line0,"
    return ((relay, ""), valve)


@dataclass(frozen=True)
class Rig:
    """A shipped bench, and what its runs promise."""

    bench: str
    rate: int
    relative: dict
    widest: dict | None = None
    repeats: int = 1
    changes: tuple = ()
    watchdog: float = 0.5
    """Time of the watchdog that vents when nobody is left [s]."""
    vents: str = ""
    """The device that has it; empty: whichever."""
    keeps: bool = False
    """Its set-point stays when nobody is left: only the dump valve vents."""
    slow: bool = False
    """Its coefficients are looked at on demand only."""

    def run(self, tmp_path, **how):
        return WholeRun(tmp_path, self.bench, *self.changes, **how)


TO_MODBUS = (("protocol: ascii", "protocol: modbus\n      unit: kPa"),)
SHARP = {"K": HARDWARE_TIMED["K"], "F_ce": HARDWARE_TIMED["F_ce"]}
RIGS = {
    "wires": Rig("wires", 100, POLLED, B_OF_POLLED, 2),
    "alicat": Rig("alicat", 50, POLLED, B_OF_POLLED, 2, vents="relay", keeps=True),
    "alicat-modbus": Rig("alicat", 50, POLLED, B_OF_POLLED, 2, TO_MODBUS, vents="relay", keeps=True, slow=True),
    "dataq": Rig("dataq", 500, SHARP, B_OF_POLLED, 2, vents="regulator"),
    "festo": Rig("festo", 100, POLLED, B_OF_POLLED, 2),
    "labjack": Rig("labjack", 500, HARDWARE_TIMED, watchdog=2.0),
    "labjack-t8": Rig("labjack-t8", 100, POLLED, B_OF_POLLED, 2, watchdog=2.0, slow=True),
    "ni": Rig("ni", 500, HARDWARE_TIMED, vents="relay", keeps=True),
    "serial_line_daq": Rig("serial-line-daq", 500, HARDWARE_TIMED),
    "serial_rig": Rig("serial", 500, POLLED, B_OF_POLLED, 2, vents="board", keeps=True),
}


def each(*names, slow=()):
    """Tests for each of these rigs, those of `slow` on demand only."""
    marked = [pytest.param(name, marks=pytest.mark.slow) if name in slow else name for name in names]
    return pytest.mark.parametrize("rig", marked)


def sampled_by_the_device(table):
    """Every sample of each trial is there, 2 ms apart by the device's own clock."""
    steps = table["time_ns"].diff().dropna()
    return set(steps[steps < 1e9]) == {2_000_000}


def of_wires(run):
    assert max(run.commanded()) == 400e3
    kept, own = run.record / "registers", shipped_folder("bench") / "registers"
    assert [path.read_text() for path in kept.iterdir()] == [(own / "pressure-regulator.yaml").read_text()]


def of_an_alicat(run):
    assert max(run.commanded()) == pytest.approx(400e3)
    assert {entry["setting"] for entry in run.entries("valves")} <= {"", "EXH"}


def of_a_t7(run):
    assert max(run.commanded()) == pytest.approx(400e3, abs=250)  # a step of the DAC is 244 Pa
    table = run.stream("t7")
    assert table["pressure_command"].max() == pytest.approx(2.0, abs=0.01)  # V: DAC0, looped
    assert sampled_by_the_device(table)


def of_a_board(run):
    sent = run.entries("set")
    assert max(entry["raw"] for entry in sent) == 1638  # 400 kPa of 4095 for 1000 kPa
    assert sent[-1]["raw"] == 0
    assert run.entries("armed")[0]["seconds"] == 0.5
    assert run.stream("board")["pressure_command"].max() == 1638
    manifest = json.loads((run.record / "manifest.json").read_text())
    assert manifest["devices"]["board"]["firmware"] == "line-daq 1"


def of_a_t8(run):
    assert run.stream("t8")["pressure_command"].max() == pytest.approx(4.0, abs=0.01)  # V: DAC0, looped


def of_a_terminal(run):
    assert max(run.commanded()) == pytest.approx(400e3)


def of_an_ni_device(run):
    assert sampled_by_the_device(run.stream("daq"))


ALSO = {
    "wires": of_wires,
    "alicat": of_an_alicat,
    "alicat-modbus": of_an_alicat,
    "festo": of_a_terminal,
    "labjack": of_a_t7,
    "labjack-t8": of_a_t8,
    "ni": of_an_ni_device,
    "serial_line_daq": of_a_board,
}
"""What else the record of a rig must show."""


@each(*RIGS, slow=[name for name, rig in RIGS.items() if rig.slow])
def test_coefficients_come_back(tmp_path, rig):
    of = RIGS[rig]
    with of.run(tmp_path, preset="bench") as run:
        assert_gives_back(run, coefficients(of.rate, of.repeats), of.relative, of.widest)
        assert_vented(run)
        ALSO.get(rig, lambda _run: None)(run)


@each(*RIGS, slow=[name for name, rig in RIGS.items() if rig.slow])
def test_all_killed_a_watchdog_vents(tmp_path, rig):
    of = RIGS[rig]
    with of.run(tmp_path) as run:
        entry = assert_dies(run, "all killed", watchdog=of.watchdog)
        assert of.vents in {"", entry["device"]}
        if of.keeps:
            assert run.commanded()[-1] >= 100e3
        if rig == "festo":  # the terminal takes its outputs away
            assert run.commanded()[-1] == 0.0
            assert run.entries("switch")[-1]["on"] is False


@pytest.mark.slow
@pytest.mark.parametrize("who", [who for who in WHO if who != "all killed"])
@each(*(name for name in RIGS if name != "labjack-t8"))
def test_whoever_dies(tmp_path, rig, who):
    of = RIGS[rig]
    with of.run(tmp_path) as run:
        assert_dies(run, who, watchdog=0.0 if rig == "labjack" and who != "all frozen" else of.watchdog)


@pytest.mark.slow
@each(*(name for name, rig in RIGS.items() if not rig.slow and name != "dataq"))
def test_emergency_stop(tmp_path, rig):
    with RIGS[rig].run(tmp_path) as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


BY_ITSELF = "watchdog"
LOST = [
    ("wires", "load_cell", "hang-up", 0.2, "load_cell", ""),
    ("wires", "gauge", "hang-up", 0.2, "gauge", ""),
    ("wires", "regulator", "silence", 0.5, "", BY_ITSELF),
    ("alicat", "controller", "silence", 0.5, "", "relay"),
    ("alicat-modbus", "controller", "silence", 0.5, "", "relay"),
    ("dataq", "daq", "hang-up", 0.2, "daq", ""),
    ("dataq", "laser", "hang-up", 0.2, "laser", ""),
    ("festo", "terminal", "silence", 0.5, "", BY_ITSELF),
    ("labjack", "t7", "silence", 2.0, "", BY_ITSELF),
    ("ni", "daq", "silence", 1.0, "", "relay"),
    ("ni", "daq", "reset", 1.0, "", "relay"),
    ("serial_line_daq", "board", "silence", 0.5, "board", BY_ITSELF),
    ("serial_rig", "controller", "hang-up", 0.5, "controller", "board"),
    ("serial_rig", "board", "hang-up", 0.5, "board", ""),
    ("serial_rig", "laser", "hang-up", 0.5, "laser", ""),
]
"""Rig, device and its fault, time to the vent [s], what the run says, and which device or what of it vents."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "device", "fault", "within", "says", "vents"), LOST, ids=["-".join(row[:3]) for row in LOST]
)
def test_a_device_that_is_lost_ends_the_run_and_the_bench_is_vented(tmp_path, rig, device, fault, within, says, vents):
    with RIGS[rig].run(tmp_path) as run:
        said, entry = assert_vents(run, lost(device, fault), within)
        assert says in said
        assert vents in {"", entry["kind"], entry["device"]}


# -- what one rig alone has ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@each("wires")
def test_after_a_session(tmp_path, rig):
    with RIGS[rig].run(tmp_path, preset="bench", session=True) as run:
        run.carried_out(one_step(100))
        assert_vented(run)
        kinds = {json.loads(path.read_text())["kind"] for path in run.out.glob("*/manifest.json")}
        assert kinds == {"session", "contraction-relaxation"}


@each("dataq")
def test_only_the_regulator_is_the_guards(rig):
    mounted = mount(shipped_folder("bench") / f"{rig}.yaml", shipped_folder("specimen") / f"{SPECIMEN}.yaml")
    guarded = {device.name: device.guarded for device in mounted.bench.devices}
    assert guarded == {"regulator": True, "daq": False, "laser": False}


@pytest.mark.slow
@each("dataq")
def test_a_loss_on_the_way_is_a_gap_in_the_record(tmp_path, rig):
    with RIGS[rig].run(tmp_path) as run:
        run.pressurised(one_step(500), 299e3)
        run.ask(device="laser", fault="lost", count=20)
        run.ask(device="daq", fault="truncated", value=1, count=1)
        assert run.process.wait(LONGEST) in {0, 6}, run.said
        for name, missing in (("laser", 21), ("daq", None)):
            found = run.stream(name)
            steps = [later - earlier for earlier, later in pairwise(found["time_ns"])]
            gaps = [step for step in steps if step > 3_000_000]
            assert len(gaps) == 1, name
            assert (found["flags"] & 1).sum() == 1
            if missing is not None:
                assert round(gaps[0] / 2e6) == missing + 1
        lines = (run.record / "events.jsonl").read_text().splitlines()
        [end] = [json.loads(line) for line in lines if '"kind":"end"' in line]
        assert end["data"]["counts"]["gaps"] >= 2


@pytest.mark.slow
@each("dataq")
def test_a_laser_that_sees_nothing_ends_the_run(tmp_path, rig):
    with RIGS[rig].run(tmp_path) as run:
        said, _ = assert_vents(run, lost("laser", "over"), 0.5, code=5)
        assert "displacement" in said


@pytest.mark.slow
@each("ni")
def test_with_the_dump_valve_on_the_device_itself(tmp_path, rig):
    with WholeRun(tmp_path, rig, *ni_alone()) as run:
        run.carried_out(one_step(500))
        assert_vented(run)
        assert max(run.commanded()) == pytest.approx(300e3, abs=31)  # a step of the output is 31 Pa
        assert {entry["device"] for entry in run.entries("switch")} == {"daq"}
        table = run.stream("daq")
        assert table["pressure_command"].max() == pytest.approx(3.0, abs=0.001)  # V: ao0, looped


@pytest.mark.slow
@each("ni")
@pytest.mark.parametrize("who", ["engine killed", "engine frozen", "guard killed", "guard frozen"])
def test_whoever_dies_at_a_rig_without_relay_module(tmp_path, rig, who):
    with WholeRun(tmp_path, rig, *ni_alone()) as run:
        assert_dies(run, who)


@pytest.mark.slow
@each("ni")
def test_all_killed_at_a_rig_without_relay_module_vents_nothing(tmp_path, rig):
    """As `check` says: the device holds pressure and valve, until somebody vents."""
    with WholeRun(tmp_path, rig, *ni_alone()) as run:
        run.pressurised(one_step(100))
        run.signal("both", signal.SIGKILL)
        time.sleep(2.0)
        assert run.commanded()[-1] >= 199e3
        assert run.entries("switch")[-1]["on"] is True
        vent = [sys.executable, "-m", "pmabench", "vent", str(run.path), "--no-color"]
        environment = {**os.environ, "PMABENCH_STATE": str(tmp_path / "state")}
        done = subprocess.run(vent, capture_output=True, text=True, env=environment, timeout=60)
        assert run.commanded()[-1] == 0.0, done.stdout + done.stderr
        assert run.entries("switch")[-1]["on"] is False


# -- an actuator holds the free end: sines, and a drive that must stop ---------------------------------------------------


@dataclass(frozen=True)
class Driven:
    """A shipped bench with a drive: which device that is, the frequencies, and who stops by itself."""

    bench: str
    drive: str
    frequencies: tuple
    by_itself: set
    friction: float
    """How far the Coulomb force may be off [N]."""


DRIVEN = {
    "festo_cmmt": Driven("festo-sine", "drive", (0.5, 1, 2), {"drive", "terminal"}, 1.5),
    "can": Driven("can", "bus", (0.5, 1), {"bus", "board"}, 2.0),
}


def sure(estimate):
    """Whether there is an estimate with an interval that says something."""
    if estimate is None or not estimate["ci95"]:
        return False
    low, high = estimate["ci95"]
    return high - low < 0.2 * estimate["value"]


@pytest.mark.slow
@each(*DRIVEN)
def test_coefficients_of_sines_come_back(tmp_path, rig):
    of = DRIVEN[rig]
    with WholeRun(tmp_path, of.bench, preset="bench") as run:
        for _ in range(TRIES):
            run.carried_out(sines(*of.frequencies))
            assert_vented(run)
            found = pooled(run)
            if all(sure(found.get(symbol)) for symbol in TRUE):
                break
            assert "flagged GAP" in run.said  # the machine has lost too many samples to say anything
        assert all(sure(found.get(symbol)) for symbol in TRUE), run.said
        moved = [entry["si"] for entry in run.entries("move")]
        assert max(moved) <= 15.001e-3
        assert min(moved) >= 0.0
        if rig == "can":
            table = run.stream("bus")
            assert table["displacement"].max() - 5000 == pytest.approx(15_000, abs=200)  # um, its zero 5 mm lower
        else:
            assert found["B"]["parts"]["skew"] > 0
        for symbol, true in TRUE.items():
            value, (low, high) = found[symbol]["value"], found[symbol]["ci95"]
            print(f"{symbol}: {value:.5g} for {true:.5g}, {low:.5g} to {high:.5g}", found[symbol]["parts"])
        assert found["K"]["value"] == pytest.approx(TRUE["K"], rel=0.02)
        low, high = found["B"]["ci95"]
        assert low <= TRUE["B"] <= high
        assert high - low <= 0.1 * TRUE["B"]
        assert found["F_c"]["value"] == pytest.approx(6.0, abs=of.friction)
        assert found["F_ce"]["value"] is None
        assert "x = 0 lies 2 amplitudes from the mean" in found["F_ce"]["note"]


@pytest.mark.parametrize(
    "who",
    [who if who == "all killed" else pytest.param(who, marks=pytest.mark.slow) for who in WHO if who != "all frozen"],
)
@each(*DRIVEN)
def test_whoever_dies_the_drive_stops_and_the_muscle_is_vented(tmp_path, rig, who):
    process, number, promised = WHO[who]
    of = DRIVEN[rig]
    with WholeRun(tmp_path, of.bench) as run:
        moment = dying(run, lambda run: run.signal(process, number))
        stopped_after(run, of.drive, moment, max(promised, 0.5) + SLACK)
        if who == "all killed":  # each by its own watchdog
            assert {entry["device"] for entry in run.entries("watchdog")} == of.by_itself


@pytest.mark.slow
@each(*DRIVEN)
def test_the_emergency_stop_stops_the_drive(tmp_path, rig):
    with WholeRun(tmp_path, DRIVEN[rig].bench) as run:
        stopped_after(run, DRIVEN[rig].drive, dying(run, e_stop), 0.2 + SLACK)
        assert "e-stop" in run.failed(code=5)


ON_THE_WAY = [
    ("festo_cmmt", "drive", "silence", "drive"),
    ("festo_cmmt", "terminal", "silence", "terminal"),
    ("festo_cmmt", "drive", "watchdog", "fault"),
    *(("can", "bus", fault, "bus") for fault in ("hang-up", "silence", "emergency", "restart", "watchdog")),
    ("can", "board", "silence", "board"),
]
"""Rig, device and its fault, and what the run says."""


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "device", "fault", "says"), ON_THE_WAY, ids=["-".join(row[:3]) for row in ON_THE_WAY])
def test_what_goes_wrong_with_a_device_stops_the_drive(tmp_path, rig, device, fault, says):
    with WholeRun(tmp_path, DRIVEN[rig].bench) as run:
        stopped_after(run, DRIVEN[rig].drive, dying(run, lost(device, fault)), 0.5 + SLACK)
        assert says in run.failed()
