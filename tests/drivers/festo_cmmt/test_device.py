"""The driver in front of the emulated drive: states, motions, stopping, lost answers, time-out."""

import time
from itertools import pairwise

import pytest
from pmabench_drivers.festo_cmmt import telegram as t

from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import Segment
from tests.drivers.common import timed, until
from tests.drivers.festo_cmmt.rigs import drive, served

pytestmark = pytest.mark.realtime

BOUND = 0.3
"""The contract is 0.2 s; the rest is for a busy machine."""


@pytest.fixture
def rig():
    """Open, in front of a drive without a time-out of its own: a busy machine does not stop it."""
    with served() as rig:
        rig.inside.timeout = 0
        rig.device.open()
        yield rig


def on(rig):
    """Under power at zero; the time-out is long, and nobody needs to feed it."""
    rig.device.arm_watchdog(20.0)
    rig.device.write("position", 0.0)
    return rig.device


def place(rig):
    return rig.emulator.plant.quantities()["displacement"]


def test_opening_commands_nothing(rig):
    rig.device.start(100.0)
    time.sleep(0.2)
    assert len(rig.device.collect().time) > 5
    assert rig.log("power") == rig.log("move") == rig.log("halt") == []
    assert not any(rig.inside._out)


def test_arming_holds_the_time_out_and_switches_on_where_it_is(rig):
    assert rig.device.arm_watchdog(0.4) == pytest.approx(0.4)
    assert rig.inside.timeout == 400
    assert until(lambda: rig.inside.enabled, 2)
    assert rig.log("move") == []


def test_a_ramp_takes_its_time_and_ends_at_its_target(rig):
    device = on(rig)
    device.start(100.0)
    begun = time.monotonic()
    device.follow("position", Segment("ramp", device._clock.now(), 0.0, 10000.0, rate=12500.0))
    [*_, moved] = rig.log("move")
    assert (moved["si"], moved["speed"]) == (pytest.approx(0.01), pytest.approx(0.0125, rel=1e-4))
    assert until(lambda: place(rig) == pytest.approx(0.01, abs=1e-6), 3)
    assert time.monotonic() - begun > 0.75  # 0.8 s; never before
    time.sleep(0.1)
    block = device.collect()
    assert all(later > earlier for earlier, later in pairwise(block.time))
    assert block.columns["displacement"][-1] == 10000
    assert block.columns["displacement_command"][-1] == 10000
    assert device.read_back("position") == 10000.0


def test_a_set_point_is_gone_to_at_the_speed_of_the_bench_file():
    with served(drive(speed="40 mm/s")) as rig:
        rig.inside.timeout = 0
        rig.device.open()
        on(rig).write("position", 2000.0)
        assert rig.log("move")[-1]["speed"] == pytest.approx(0.04, rel=1e-3)


def test_a_sine_stays_between_its_crests_and_returns_to_its_mean(rig):
    device = on(rig)
    device.follow("position", Segment("ramp", device._clock.now(), 0.0, 10000.0, rate=50000.0))
    assert until(lambda: place(rig) == pytest.approx(0.01, abs=1e-6), 3)
    device.start(100.0)
    device.follow("position", Segment("sine", device._clock.now(), 10000.0, amplitude=5000.0, frequency=2.0, cycles=3))
    time.sleep(1.8)
    x = device.collect().columns["displacement"]
    assert 14500 < max(x) <= 15000
    assert 5000 <= min(x) < 5500
    assert x[-1] == pytest.approx(10000, abs=1)
    sent = [entry["si"] for entry in rig.log("move")]
    assert max(sent) <= 0.015
    assert len(sent) > 50


def test_halt_stops_at_once_and_the_sine_is_over(rig):
    device = on(rig)
    device.follow("position", Segment("sine", device._clock.now(), 0.0, amplitude=5000.0, frequency=0.5, cycles=50))
    assert until(lambda: place(rig) > 2e-3, 2)
    took, outcome = timed(device.halt, "position")
    assert outcome is None
    assert took < BOUND
    is_there, moves = place(rig), len(rig.log("move"))
    time.sleep(0.3)
    assert place(rig) == pytest.approx(is_there, abs=1e-5)
    assert len(rig.log("move")) == moves
    assert rig.inside.enabled  # it holds
    device.write("position", 0.0)  # and goes on when it is told to
    assert until(lambda: place(rig) == pytest.approx(0.0, abs=1e-6), 2)


def test_halt_is_not_overtaken_by_the_sine(rig):
    """Answers are slow, so that cycles fall due between the command to stop and the look whether it stands."""
    device = on(rig)
    device.follow("position", Segment("sine", device._clock.now(), 0.0, amplitude=5000.0, frequency=0.5, cycles=50))
    assert until(lambda: place(rig) > 1e-3, 2)
    rig.server.faults.set("delay", 0.03)
    device.halt("position")
    rig.server.faults.set("clear")
    moves, [*_, halted] = rig.log("move"), rig.log("halt")
    assert moves[-1]["t"] < halted["t"]


def test_halt_switches_nothing_on(rig):
    rig.inside._inhibited = False  # one more command is all that it would take
    rig.device.halt("position")
    time.sleep(0.1)
    assert rig.log("power") == []
    assert not rig.inside.enabled


def test_a_drive_that_does_not_stop_is_reported(rig, monkeypatch):
    device = on(rig)
    device.follow("position", Segment("ramp", device._clock.now(), 0.0, 20000.0, rate=5000.0))
    monkeypatch.setattr(rig.inside, "_hold", lambda: None)
    why = "drive.position: was commanded to stop and still moves"
    assert until(lambda: why in str(timed(device.halt, "position")[1]), 2)


@pytest.mark.parametrize(("pace", "obeys"), [(lambda t: 450 * t, False), (lambda t: 2e5 * t - 3e5 * t * t, True)])
def test_a_drive_that_creeps_on_after_its_stop_is_switched_off_and_one_that_brakes_is_not(
    rig, monkeypatch, pace, obeys
):
    """It crept for 5.7 s although the stop was sent 40 times."""
    device, begun = on(rig), time.monotonic()
    monkeypatch.setattr(device, "_look", lambda _until: t.Status(0x0B07, round(pace(time.monotonic() - begun)), 0))
    with pytest.raises(DeviceError, match="and still moves") as raised:
        device.halt("position")
    assert isinstance(raised.value, NotSent) != obeys
    assert until(lambda: rig.inside.enabled == obeys, 2)


# -- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("what", "value", "words"),
    [
        ("control", False, "gives no control to the network"),
        ("homed", False, "is not homed, and its positions mean nothing"),
        ("fault", 126, "reports fault 126: it could not follow"),
        ("supplied", False, "is not ready to be switched on"),
    ],
)
def test_a_drive_that_cannot_be_switched_on_says_why(rig, what, value, words):
    setattr(rig.inside, what, value)
    took, outcome = timed(rig.device.arm_watchdog, 20.0)
    assert isinstance(outcome, DeviceError)
    assert words in str(outcome)
    assert took < BOUND
    assert rig.log("power") == rig.log("move") == []


def test_a_fault_is_acknowledged_only_where_the_bench_file_says_so():
    with served(drive(acknowledge_faults=True)) as rig:
        rig.inside.timeout, rig.inside.fault = 0, 126
        rig.device.open()
        on(rig)
        assert rig.inside.fault == 0
        assert rig.inside.enabled


def test_a_target_outside_its_stroke_ends_in_a_fault_that_the_samples_show(rig):
    device = on(rig)
    device.start(100.0)
    why = "reports fault 110: it came to its positive software limit"
    assert until(lambda: why in str(timed(device.write, "position", 95000.0)[1]), 2)
    assert until(lambda: why in str(timed(device.collect)[1]), 3)


def test_a_drive_that_something_holds_has_a_following_error(rig):
    device = on(rig)
    device.follow("position", Segment("ramp", device._clock.now(), 0.0, 20000.0, rate=20000.0))
    rig.emulator.plant.stop_drive()  # something is in its way
    assert until(lambda: rig.inside.fault == 126, 3)
    assert not rig.inside.enabled
    assert until(lambda: "reports fault 126" in str(timed(device.write, "position", 0.0)[1]), 2)


# -- lost answers ---------------------------------------------------------------------------------------------------


def test_a_drive_that_hangs_up_is_found_again(rig):
    device = on(rig)
    device.start(100.0)
    rig.server.faults.set("hang-up", count=1)
    time.sleep(0.2)
    device.write("position", 1000.0)
    assert device.read_back("position") == 1000.0
    device.collect()


@pytest.mark.parametrize("kind", ["silence", "lost", "hang-up", "truncated", "garbage"])
def test_a_drive_without_answers_is_an_error_in_time(rig, kind):
    device = on(rig)
    device.start(100.0)
    rig.server.faults.set(kind)
    for call, arguments in (
        (device.write, ("position", 500.0)),
        (device.read_back, ("position",)),
        (device.halt, ("position",)),
        (device.feed_watchdog, ()),
    ):
        took, outcome = timed(call, *arguments)
        assert isinstance(outcome, DeviceError), call
        assert took < BOUND
    rig.server.faults.set("clear")

    def well():
        return timed(device.halt, "position")[1] is None

    assert until(well, 2)


def test_samples_that_stay_away_are_reported_after_a_quarter_of_a_second(rig):
    rig.device.start(100.0)
    rig.server.faults.set("silence")
    time.sleep(0.15)
    rig.device.collect()
    assert until(lambda: isinstance(timed(rig.device.collect)[1], DeviceError), 2)


# -- the time-out ---------------------------------------------------------------------------------------------------


def test_a_drive_that_nobody_feeds_stops_by_itself():
    with served() as rig:
        rig.device.open()
        rig.device.arm_watchdog(0.2)
        rig.device.write("position", 0.0)
        rig.device.follow(
            "position", Segment("sine", rig.device._clock.now(), 0.0, amplitude=5000.0, frequency=0.5, cycles=50)
        )
        fed = time.monotonic()
        assert until(lambda: rig.log("watchdog"), 3)
        assert rig.log("watchdog")[0]["t"] - fed < 0.2 + 0.1 + 0.3  # the cycle falls silent after 0.1 s at most
        is_there = place(rig)
        time.sleep(0.2)
        assert place(rig) == pytest.approx(is_there, abs=1e-5)
        assert not rig.inside.enabled


def test_what_was_armed_stays_armed_when_it_is_closed(rig):
    device = on(rig)
    device.close()
    time.sleep(0.1)
    assert rig.inside.enabled
    assert rig.inside.timeout == 20000


def test_disarmed_it_has_its_time_out_back_and_is_switched_off(rig):
    rig.inside.timeout = 0
    device = on(rig)
    device.disarm_watchdog()
    assert rig.inside.timeout == 0
    assert rig.inside.enabled
    device.close()
    assert until(lambda: not rig.inside.enabled, 1)
    device.close()


def test_a_place_that_leaps_is_a_lost_zero_until_it_is_begun_anew(rig):
    """The drive went on by what its reference was shifted, and the run was finished."""
    device = on(rig)
    device.start(100.0)
    device.follow("position", Segment("ramp", device._clock.now(), 0.0, 40000.0, rate=400_000.0))
    time.sleep(0.2)
    assert device.collect().time, "no more than the actuator does"
    rig.inside.zero += 30_000
    assert until(lambda: "was its zero set anew?" in str(timed(device.collect)[1]), 2)
    device.start(100.0)
    assert until(lambda: len(device.collect().time), 2), "the vent sees whether it rests"
