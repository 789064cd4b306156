"""A vent goes on until it is over: what comes back, what is missed, what fills, what moves (S3, S13)."""

import threading
from dataclasses import replace

import pytest

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import ChannelRecord, DeviceRecord, SafeAction, Scale
from pmabench.guard.guard import Guard, State
from pmabench.guard.remote import vent_directly
from pmabench.guard.safe import LINGERS, NO_EFFECT, REPEAT, STAYS
from pmabench.guard.station import Station
from tests.guard.rig import BENCH, DEVICE, DRIVE, DRIVER, OUTPUT, SAFE, VALVE, Rig, armed, bench, opened
from tests.guard.test_muscles import PAIR

RAMP = SafeAction("ramp", "pressure", 0.0, 5.0, 100e3)
LOOK = SafeAction("confirm", "pressure", 20e3, 5.0)
RAMPED = bench(safe_state=(RAMP, LOOK))
PATIENT = bench(safe_state=(*SAFE[:3], LOOK))


def over(guard, measure, step=0.05):
    """Step the safe state with what `measure` gives over the time since now; when it was over [s], and the vent."""
    begun = guard.clock.now()
    while (vent := guard.step_safe(measure(guard.clock.now() - begun))) is None:
        guard.clock.wait_until(guard.clock.now() + step)
        assert guard.clock.now() < begun + 30.0
    return guard.clock.now() - begun, vent


def until(guard, happened, measure, step=0.05):
    """Step the safe state until something happened; when [s]."""
    begun = guard.clock.now()
    while not happened():
        guard.step_safe(measure(guard.clock.now() - begun))
        guard.clock.wait_until(guard.clock.now() + step)
        assert guard.clock.now() < begun + 12.0
    return guard.clock.now() - begun


def si(segment):
    return segment.origin * OUTPUT.scale.slope


# -- a safe ramp never fills --------------------------------------------------------------------------------------------


def test_a_safe_ramp_begins_at_most_at_what_is_measured():
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    rig.reads["pressure"] = 40e3
    guard.collect("dac")
    guard.begin_safe()
    guard.step_safe({})
    assert [si(segment) <= 40e3 for _, _, segment in rig.values("follow")] == [True]


@pytest.mark.parametrize("fault", ["restarted", "silent", "empty"])
def test_a_muscle_that_is_empty_is_not_filled_by_the_safe_ramp(fault):
    """Its regulator began anew with its output at 0, or does not say what it holds, or nothing is measured."""
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    if fault == "restarted":
        rig.at["p"] = lambda _now: 0.0
    elif fault == "silent":
        rig.wrong["read_back"] = "no answer"
    else:
        rig.reads["pressure"] = -200.0
        guard.collect("dac")
    rig.reported.clear()
    guard.begin_safe()
    _, vent = over(guard, lambda _: {"pressure": 1e3})
    assert rig.values("follow") == []
    assert rig.values("write")[0] == ("write", "p", 0.0)
    assert vent.actions[0] == "ramp pressure: sent at once"


@pytest.mark.parametrize(("fault", "within"), [("elsewhere", 0.7), ("silent", 1.7), ("emptied", 0.15)])
def test_a_safe_ramp_ends_at_once_where_its_device_goes_away_meanwhile(fault, within):
    """A watchdog empties the muscle while the line is down; what is left of the ramp would fill it again."""
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    rig.reported.clear()
    guard.begin_safe()
    for _ in range(4):
        assert guard.step_safe({"pressure": 290e3}) is None
        guard.clock.wait_until(guard.clock.now() + 0.25)
    assert [kind for kind, *_ in rig.values("write", "follow")] == ["follow"], "well so far"
    if fault == "elsewhere":
        rig.at["p"] = lambda _now: OUTPUT.scale.to_raw(500e3)
    elif fault == "silent":
        rig.wrong["read_back"] = "no answer"
    lost = guard.clock.now()
    while not rig.values("write"):
        guard.step_safe({"pressure": 10e3} if fault == "emptied" else {})
        guard.clock.wait_until(guard.clock.now() + 0.05)
        assert guard.clock.now() < lost + 3.0
    assert guard.clock.now() - lost <= within


def test_one_lost_answer_ends_no_safe_ramp():
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    rig.reported.clear()
    guard.begin_safe()
    for step in range(28):
        if 6 <= step <= 10:  # one question falls into this
            rig.wrong["read_back"] = "no answer"
        guard.step_safe({"pressure": 300e3 - step * 10e3})
        rig.wrong.clear()
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert rig.values("write") == []


def test_a_guard_that_comes_later_measures_before_its_ramp():
    """The set-point of a device whose watchdog has vented may still be the old one."""
    where = Station("rig")
    where.folder.mkdir(parents=True)
    made = bench(replace(DEVICE, driver=f"{__name__}:Holds"), safe_state=(replace(RAMP, within=0.2), SAFE[3]))
    assert vent_directly(made, where, "test").confirmed
    assert Rig.made["dac"].values("follow") == []


class Holds(Rig):
    """It holds 400 kPa as set-point; the muscle is empty."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        self.at["p"] = lambda _now: OUTPUT.scale.to_raw(400e3)


# -- all that confirms is low together, at the end --------------------------------------------------------------------


def test_a_muscle_that_was_low_and_fills_again_is_seen_while_another_one_vents():
    guard, _rig = armed(PAIR)
    guard.begin_safe()
    _, vent = over(guard, lambda t: {"pressure_1": 300e3 if t > 0.7 else 1e3, "pressure_2": 300e3 if t < 0.6 else 1e3})
    assert vent.result == "commanded"
    assert vent.actions[-2:] == (
        "confirm pressure_1: 300 kPa, not below 20 kPa within 1 s",
        "confirm pressure_2: 1 kPa, and not for long, not below 20 kPa within 1 s",
    )


def test_a_confirmation_between_actions_is_waited_for_and_looked_at_again_at_the_end():
    close = SafeAction("close", "dump_valve", 0.0, 0.2)
    guard, rig = armed(bench(safe_state=(SAFE[1], LOOK, close)))
    guard.begin_safe()
    _, vent = over(guard, lambda t: {"pressure": 1e3 if 0.3 < t < 1.0 else 300e3})
    assert rig.values("switch")[0] == ("switch", "v", True)
    assert vent.result == "commanded"


def test_a_pressure_that_comes_back_is_commanded_down_at_once_and_its_line_stays():
    """A step that was answered late: 0 works on it, as it did before."""
    guard, rig = armed(PATIENT)
    rig.wrong["write"] = "did not answer"
    with pytest.raises(DeviceError):
        guard.set("pressure", 400e3)
    rig.wrong.clear()
    guard.begin_safe()
    last = []

    def measure(t):
        high = 2.2 < t < 2.2 + 0.3
        if high and not last:
            last.append(len(rig.values("write")))
        return {"pressure": 326e3 if high else 0.0}

    took, vent = over(guard, measure)
    assert vent.confirmed
    assert guard.state is State.TRIPPED, "whether it comes later still, nobody knows"
    guard.close()
    assert rig.values("disarm_watchdog") == []
    assert took >= LINGERS
    assert len(rig.values("write")) > last[0]
    assert len(rig.values("close")) == 1


def test_a_late_step_of_a_drivers_own_ramp_is_overruled_too():
    guard, rig = armed(PATIENT)
    guard.begin_safe()
    rig.unanswered = guard.clock.now() + 0.1  # noted by the driver's thread after the vent began
    took, vent = over(guard, lambda _: {"pressure": 0.0})
    assert vent.confirmed
    assert took >= 0.1 + LINGERS + STAYS
    assert "a command was not answered" in vent.actions[-1]


def test_what_a_guard_that_died_sent_last_may_still_come(monkeypatch):
    monkeypatch.setattr("pmabench.guard.safe.LINGERS", 0.7)
    where = Station("rig")
    where.folder.mkdir(parents=True)
    where.note("armed", run="r")
    vent = vent_directly(BENCH, where, "test")
    assert vent.confirmed
    assert "a command was not answered" in vent.actions[-1]


def test_a_command_that_was_refused_before_it_was_sent_is_not_waited_for():
    guard, rig = armed(PATIENT)
    rig.wrong["follow"] = NotSent("dac", "cannot jump", "x")
    with pytest.raises(DeviceError, match="cannot jump"):
        guard.ramp("pressure", 0.0, 1e5, 1e3)
    guard.begin_safe()
    took, _ = over(guard, lambda _: {"pressure": 0.0})
    assert took < 1.0


# -- a device that is away --------------------------------------------------------------------------------------------

COMMANDS = ("write", "switch", "halt", "rescue", "read_back", "is_on")


def test_a_device_that_is_back_is_commanded_at_the_next_repeat_also_where_it_has_a_watchdog():
    guard, rig = armed(bench(replace(DEVICE, watchdog=5.0), safe_state=PATIENT.safe_state))
    guard.set("pressure", 300e3)
    rig.wrong |= dict.fromkeys(COMMANDS, "no answer")
    rig.reported.clear()
    guard.begin_safe()
    until = guard.clock.now() + 0.3
    while guard.clock.now() < until:
        guard.step_safe({})
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert not guard.feeds(guard.bench.devices[0]), "it hears nothing, or the safe value"
    rig.wrong.clear()
    took, vent = over(guard, lambda _: {"pressure": 300e3 if not rig.values("write") else 1e3})
    assert took < REPEAT + STAYS + 0.3
    assert vent.confirmed
    assert guard.feeds(guard.bench.devices[0])
    assert rig.values("close") == []


def test_a_link_that_never_comes_back_by_itself_is_opened_anew():
    guard, rig = armed(bench(replace(DEVICE, watchdog=0.0), safe_state=PATIENT.safe_state))
    guard.links.stream("dac", 20.0)
    rig.wrong |= dict.fromkeys(COMMANDS, "the adapter was unplugged")
    guard.begin_safe()
    _, vent = over(guard, lambda _: {"pressure": 300e3 if Rig.made["dac"] is rig else 1e3})
    again = Rig.made["dac"]
    assert again is not rig
    assert vent.confirmed
    assert again.reported[:5] == [
        ("open",),
        ("start", 20.0),
        ("halt", "x"),
        ("write", "p", 0.0),
        ("switch", "v", False),
    ]


class ComesLate(Rig):
    """Its first openings are not answered."""

    misses = 2

    def open(self):
        if (left := type(self).misses) > 0:
            type(self).misses = left - 1
            raise DeviceError(self.device.name, "no answer")
        return super().open()


def test_a_vent_without_a_guard_opens_what_it_missed_again():
    """One lost answer, the first on a new connection, left a muscle at its pressure."""
    ComesLate.misses = 2
    where = Station("rig")
    where.folder.mkdir(parents=True)
    made = bench(replace(DEVICE, driver=f"{__name__}:ComesLate"), safe_state=PATIENT.safe_state)
    vent = vent_directly(made, where, "test")
    assert vent.confirmed
    assert ("write", "p", 0.0) in Rig.made["dac"].reported
    assert where.latched(), "a command failed at first"


# -- one device's failure is its own ----------------------------------------------------------------------------------

OTHER = DeviceRecord(
    "other", DRIVER, outputs=(replace(DRIVE, device="other"),), watchdog=0.5,
    channels=(ChannelRecord("displacement", "length", "other", "x", "float64", "m", Scale(), -0.1, 0.1),),
)  # fmt: skip
REGULATOR = replace(DEVICE, outputs=(OUTPUT,))
BOTH = (OTHER, REGULATOR)


def of_both(*actions):
    return armed(bench(devices=BOTH, safe_state=actions))


def test_a_drive_that_fails_does_not_end_the_regulators_ramp():
    guard, rig = of_both(SAFE[0], RAMP, LOOK)
    guard.set("pressure", 300e3)
    Rig.made["other"].wrong |= dict.fromkeys(COMMANDS, "the bus is off")
    guard.begin_safe()
    for step in range(25):
        guard.step_safe({"pressure": 300e3 - step * 10e3})
        assert guard.feeds(REGULATOR)
        assert not (guard.feeds(OTHER) and step < 8), "until it is opened anew"
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert rig.values("write") == [("write", "p", OUTPUT.scale.to_raw(300e3))]


def test_each_regulator_is_left_to_its_watchdog_by_its_own_muscle():
    outputs = PAIR.devices[0].outputs
    devices = [
        replace(DEVICE, name=f"reg{n}", outputs=(replace(output, device=f"reg{n}"),), channels=(), valves=())
        for n, output in enumerate(outputs)
    ]
    valve = DeviceRecord("island", DRIVER, valves=(replace(VALVE, device="island"),), watchdog=1.0)
    safe = (*PAIR.safe_state[:3], *(replace(look, within=5.0) for look in PAIR.safe_state[3:]))
    guard = Guard(replace(PAIR, devices=(*devices, valve), safe_state=safe), VirtualClock())
    guard.open()
    guard.arm()
    guard.begin_safe()
    until = guard.clock.now() + NO_EFFECT + 0.3
    while guard.clock.now() < until:
        guard.step_safe({"pressure_1": 300e3, "pressure_2": 1e3})
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert [guard.feeds(record) for record in guard.bench.devices] == [False, True, False]
    assert {"reg0", "reg1", "island"} - {*guard.devices} == {"reg0", "island"}


# -- a motion comes to rest -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "result", "said"),
    [
        (lambda t: 10e-3 + 30e-3 * min(t, 0.2), "confirmed", "rest displacement: 16 mm, at rest"),
        (lambda t: 10e-3 + 30e-3 * t, "commanded", "and not at rest within 5 s"),
        (lambda _: None, "commanded", "rest displacement: nothing measured, and not at rest within 5 s"),
    ],
)
def test_a_drive_that_acknowledges_a_stop_must_come_to_rest(place, result, said):
    """A servo whose brake is broken says that it has stopped, and goes on."""
    guard, _ = of_both(SAFE[0], SAFE[1], LOOK)
    guard.begin_safe()

    def measure(t):
        x = place(t)
        return {"pressure": 1e3} | ({} if x is None else {"displacement": x})

    _, vent = over(guard, measure)
    assert (vent.result, said in vent.actions[-1]) == (result, True), vent.actions
    moves = "other: its line is closed, so that its watchdog takes over" in vent.actions
    assert moves == (place(2.0) == 10e-3 + 30e-3 * 2.0)
    assert guard.feeds(REGULATOR)
    guard.close()
    assert bool(Rig.made["other"].values("disarm_watchdog")) == vent.confirmed


def test_a_vent_without_a_guard_sees_a_drive_stop_by_a_gauge_that_only_measures():
    where = Station("rig")
    where.folder.mkdir(parents=True)
    gauge = DeviceRecord("gauge", DRIVER, channels=tuple(replace(c, device="gauge") for c in OTHER.channels))
    made = bench(devices=(replace(OTHER, channels=()), REGULATOR, gauge), safe_state=(SAFE[0], SAFE[1], LOOK))
    vent = vent_directly(made, where, "test")
    assert vent.confirmed, vent.actions
    assert vent.actions[-1] == "rest displacement: 0 mm, at rest"


def test_a_ramp_of_a_drive_that_fails_is_followed_by_a_stop_and_not_by_a_quicker_motion():
    ramp = SafeAction("ramp", "displacement", 0.0, 3.0, 10e-3)
    guard, _ = of_both(ramp, SAFE[1], LOOK)
    drive = Rig.made["other"]
    drive.wrong["follow"] = "no heartbeat; it is not moved"
    drive.reported.clear()
    guard.begin_safe()
    over(guard, lambda t: {"pressure": 300e3 if t < 2.0 else 1e3, "displacement": 5e-3})
    assert {kind for kind, *_ in drive.values("halt", "write", "follow")} == {"halt"}


def test_a_ramp_of_a_drive_is_sent_once():
    ramp = SafeAction("ramp", "displacement", 0.0, 3.0, 10e-3)
    guard, _ = of_both(ramp, SAFE[1], LOOK)
    drive = Rig.made["other"]
    guard.set("displacement", 10e-3)
    drive.reported.clear()
    guard.begin_safe()
    took, vent = over(guard, lambda t: {"pressure": 1e3, "displacement": max(0.0, 10e-3 * (1 - t))})
    assert vent.confirmed
    assert took >= 1.0 + STAYS
    assert [kind for kind, *_ in drive.values("halt", "write", "follow")] == ["follow"]


def test_in_a_hurry_a_drive_stops_where_it_is():
    ramp = SafeAction("ramp", "displacement", 0.0, 3.0, 10e-3)
    guard, _ = of_both(ramp, RAMP, LOOK)
    drive = Rig.made["other"]
    drive.reported.clear()
    guard.begin_safe(hurry=True)
    over(guard, lambda _: {"pressure": 1e3, "displacement": 5e-3})
    assert drive.values("halt", "write", "follow") == [("halt", "x")]
    assert [kind for kind, *_ in Rig.made["dac"].values("write", "follow")] == ["write"]


# -- samples that end -------------------------------------------------------------------------------------------------


def test_a_gauge_that_gives_a_value_each_second_is_not_begun_anew_before_it_came():
    guard = Guard(bench(replace(DEVICE, fastest=1.0)), VirtualClock())
    guard.open()
    for _ in range(25):
        guard.keep_measuring(20.0)
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert Rig.made["dac"].values("start") == [("start", 20.0)]


def test_samples_that_end_while_it_vents_are_begun_again():
    guard = Guard(BENCH, RealClock())
    guard.open()
    rig = Rig.made["dac"]
    guard.keep_measuring(20.0)
    guard.keep_measuring(20.0)
    assert rig.values("start") == [("start", 20.0)]
    guard.collect("dac")
    rig.collect = lambda: type("Empty", (), {"time": [], "columns": {}})()
    guard.clock.wait_until(guard.clock.now() + 0.35)
    guard.collect("dac")
    rig.wrong["start"] = "no answer"
    guard.keep_measuring(20.0)
    del rig.wrong["start"]
    guard.keep_measuring(20.0)
    assert len(rig.values("start")) == 2
    guard.close()


# -- what is confirmed was acknowledged -------------------------------------------------------------------------------


@pytest.mark.parametrize("watchdog", [0.0, 5.0])
@pytest.mark.parametrize("lost", ["write", "switch"])
def test_a_command_that_was_missed_is_sent_again_as_soon_as_its_device_answers(lost, watchdog):
    """One lost request: nothing was sent again, or the line was closed, as it held what it held before."""
    guard, rig = armed(bench(replace(DEVICE, watchdog=watchdog), safe_state=PATIENT.safe_state))
    guard.set("pressure", 300e3)
    rig.wrong |= {lost: "did not answer", "rescue": "did not answer"}
    rig.reported.clear()
    guard.begin_safe()
    for _ in range(4):
        guard.step_safe({"pressure": 0.0})
        guard.clock.wait_until(guard.clock.now() + 0.05)
    rig.wrong.clear()
    took, vent = over(guard, lambda _: {"pressure": 0.0})
    assert rig.values(lost)[0] in {("write", "p", 0.0), ("switch", "v", False)}
    assert took < 0.1 + STAYS + 0.2
    assert vent.confirmed
    assert any(text.endswith("sent again") for text in vent.actions)
    assert rig.values("close") == []


def test_a_ramp_that_was_missed_is_sent_again_as_a_step():
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    rig.wrong |= {"follow": "did not answer", "rescue": "did not answer"}
    rig.reported.clear()
    guard.begin_safe()
    _, vent = over(guard, lambda _: {"pressure": 0.0})
    assert ("write", "p", 0.0) in rig.values("write")
    assert vent.confirmed


def test_an_empty_muscle_whose_regulator_never_took_the_command_is_not_confirmed():
    Deaf.deaf = False
    guard, _ = armed(bench(replace(DEVICE, driver=f"{__name__}:Deaf"), safe_state=PATIENT.safe_state))
    guard.set("pressure", 300e3)
    Deaf.deaf = True
    guard.begin_safe()
    took, vent = over(guard, lambda _: {"pressure": 0.0})
    assert (vent.result, took >= LOOK.within) == ("commanded", True)
    assert vent.actions[-1].startswith("pressure: what it holds is not known")
    guard.close()
    assert Rig.made["dac"].values("disarm_watchdog") == []


class Deaf(Rig):
    """It answers, and no command reaches it, by any connection."""

    deaf = False

    def _note(self, what, *how):
        if self.deaf and what in {"write", "rescue"}:
            raise DeviceError(self.device.name, "did not answer")
        super()._note(what, *how)


# -- what a ramp or a hold waits for must happen ----------------------------------------------------------------------

SLOW = replace(RAMP, rate=30e3, within=20.0)
HOLD = SafeAction("hold", "", 0.0, 5.0)


@pytest.mark.parametrize(
    ("first", "pressure", "ends"),
    [
        (SLOW, lambda t: 300e3 - 30e3 * max(t - 1.0, 0.0), 9.9),  # late by 30 kPa, as behind a long tube
        (SLOW, lambda t: max(300e3 - 30e3 * t, 280e3), 0.7 + 30 / 30 + 0.7),  # stuck
        (SLOW, lambda t: 300e3 - 30e3 * t if t < 0.5 else 680e3, 0.6),  # fills
        (HOLD, lambda _: 310e3, 4.9),
        (HOLD, lambda t: 300e3 if t < 0.5 else 340e3, 0.5 + NO_EFFECT),
        (HOLD, lambda t: 300e3 if t < 0.5 else 680e3, 0.6),
        (HOLD, lambda t: 680e3 if 0.5 < t < 0.6 else 300e3, 4.9),  # two readings
    ],
)
def test_a_ramp_or_a_hold_ends_where_the_pressure_does_not_follow(first, pressure, ends):
    """A valve that stuck kept 287 kPa for 9.5 s, and a regulator that drove to its supply was waited for."""
    guard, rig = armed(bench(safe_state=(first, *SAFE[1:])))
    rig.reads["pressure"] = 300e3
    guard.collect("dac")
    guard.set("pressure", 300e3)
    guard.begin_safe()
    took = until(guard, lambda: rig.values("switch"), lambda t: {"pressure": pressure(t)})
    assert took == pytest.approx(ends, abs=0.2)


@pytest.mark.parametrize(("stuck", "reads", "ends"), [(1, 300e3, 0.3 + NO_EFFECT), (2, 380e3, NO_EFFECT)])
def test_a_muscle_that_does_not_follow_ends_its_own_ramp_and_leaves_the_other_one_its_own(stuck, reads, ends):
    """The other one was let go in a step, and the joint thrown by 30 degrees."""
    names = ("pressure_1", "pressure_2")
    ramps = [SafeAction("ramp", name, 0.0, 5.0, 100e3) for name in names]
    guard, rig = armed(replace(PAIR, safe_state=(*ramps, *PAIR.safe_state[3:], *PAIR.safe_state[2:])))
    for name in names:
        guard.set(name, 300e3)
    rig.reported.clear()
    guard.begin_safe()
    mine, other = f"pressure_{stuck}", f"pressure_{3 - stuck}"

    def measure(_t):
        return {**{name: 150.0 * rig.at[name](guard.clock.now()) for name in names}, mine: reads}

    assert until(guard, lambda: ("write", mine, 0.0) in rig.reported, measure) == pytest.approx(ends, abs=0.15)
    assert until(guard, lambda: rig.values("close"), measure) < 1.0, "it is left to its watchdog"
    assert ("write", other, 0.0) not in rig.reported
    assert other in [name for _, name, _ in rig.values("follow")]


def test_one_reading_of_nothing_makes_no_step_of_a_ramp():
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    rig.reported.clear()
    guard.begin_safe()
    for step in range(28):
        guard.step_safe({"pressure": 0.0 if step % 5 == 0 else 300e3 - step * 10e3})
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert rig.values("write") == []


def test_a_hold_of_a_guard_that_comes_later_is_not_cut_short():
    """Nobody knows what was commanded."""
    guard, rig = opened(bench(safe_state=(HOLD, *SAFE[1:])), threads=False)
    guard.begin_safe()
    for _ in range(48):
        guard.step_safe({"pressure": 300e3, "force": 50.0})
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert rig.values("write") == []


def test_a_drive_that_runs_away_while_a_pressure_is_let_down_ends_no_ramp():
    ramp = SafeAction("ramp", "displacement", 0.0, 1.0, 10e-3)
    guard, rig = of_both(ramp, RAMP, SAFE[1], LOOK)
    drive = Rig.made["other"]
    guard.set("pressure", 300e3)
    guard.set("displacement", 5e-3)
    guard.begin_safe()

    def measure(t):
        return {"pressure": 300e3 - 100e3 * max(t - 0.5, 0), "displacement": 30e-3 * max(t - 0.5, 0)}

    assert until(guard, lambda: drive.values("halt"), measure) < 1.5
    rig.reported.clear()
    guard.step_safe({})
    assert rig.values("write") == []


@pytest.mark.parametrize(("speed", "within"), [(30e-3, 0.5), (0.0, 1.3), (-20e-3, None)])
def test_a_drive_that_does_not_go_to_its_place_is_stopped(speed, within):
    """It ran the other way to the end of its stroke, and nothing stopped it."""
    ramp = SafeAction("ramp", "displacement", 0.0, 4.0, 10e-3)
    guard, _ = of_both(ramp, SAFE[1], LOOK)
    drive = Rig.made["other"]
    guard.set("displacement", 20e-3)
    drive.reported.clear()
    guard.begin_safe()
    begun = guard.clock.now()
    while not drive.values("halt") and guard.clock.now() < begun + 2.0:
        x = 20e-3 + speed * (guard.clock.now() - begun)
        guard.step_safe({"pressure": 1e3, "displacement": max(x, 0.0)})
        guard.clock.wait_until(guard.clock.now() + 0.05)
    assert bool(drive.values("halt")) == (within is not None)
    assert within is None or guard.clock.now() - begun <= within


def test_a_drive_that_was_stopped_in_a_hurry_is_at_rest_and_not_astray():
    ramp = SafeAction("ramp", "displacement", 0.0, 4.0, 10e-3)
    guard, _ = of_both(ramp, SAFE[1], LOOK)
    guard.set("displacement", 20e-3)
    guard.begin_safe()
    guard.step_safe({"displacement": 20e-3})
    guard.begin_safe(hurry=True)
    _, vent = over(guard, lambda t: {"pressure": 300e3 if t < 2.0 else 1e3, "displacement": 20e-3})
    assert vent.confirmed
    assert guard.state is State.SAFE


def test_what_comes_after_a_ramp_of_a_drive_that_was_stopped_takes_its_time():
    ramp = SafeAction("ramp", "displacement", 0.0, 4.0, 10e-3)
    guard, rig = of_both(ramp, replace(HOLD, within=2.0), SAFE[1], LOOK)
    guard.set("displacement", 20e-3)
    guard.set("pressure", 300e3)
    rig.reported.clear()
    guard.begin_safe()

    def measure(_t):
        return {"pressure": 300e3, "displacement": 20e-3}

    until(guard, lambda: Rig.made["other"].values("halt"), measure)
    assert until(guard, lambda: rig.values("write"), measure) == pytest.approx(2.0, abs=0.15)


def test_a_drive_that_leaves_its_place_is_stopped_and_ends_no_hold():
    ramp = SafeAction("ramp", "displacement", 0.0, 4.0, 10e-3)
    guard, rig = of_both(ramp, replace(HOLD, within=2.0), SAFE[1], LOOK)
    guard.set("displacement", 3e-3)
    guard.set("pressure", 300e3)
    rig.reported.clear()
    guard.begin_safe()

    def measure(t):
        return {"pressure": 300e3, "displacement": max(3e-3 - 10e-3 * t, 0.0) + 20e-3 * max(t - 0.6, 0.0)}

    assert until(guard, lambda: Rig.made["other"].values("halt"), measure) < 1.2
    assert until(guard, lambda: rig.values("write"), lambda _t: measure(0.6)) > 1.0


@pytest.mark.parametrize("moves", [lambda t: 3e-3 + 20e-3 * t, lambda t: 6e-3 * max(t - 0.3, 0.0)])
def test_a_drive_that_moves_on_after_its_ramp_is_stopped_before_it_is_given_up(moves):
    ramp = SafeAction("ramp", "displacement", 0.0, 4.0, 10e-3)
    guard, _ = of_both(ramp, SAFE[1], LOOK)
    drive = Rig.made["other"]
    guard.set("displacement", 3e-3)
    guard.begin_safe()
    begun = guard.clock.now()

    def measure(t):
        place.append(place[-1] if drive.values("halt") else moves(t))
        return {"pressure": 1e3, "displacement": place[-1]}

    place = [3e-3]
    _, vent = over(guard, measure)
    assert guard.clock.now() > begun
    assert drive.values("halt")
    assert vent.confirmed


# -- while it vents ---------------------------------------------------------------------------------------------------


def test_a_gauge_that_gives_no_number_is_no_high_value():
    """The line of its regulator was closed for longer than the confirmation was waited for."""
    guard, rig = armed(bench(replace(DEVICE, watchdog=5.0), safe_state=PATIENT.safe_state))
    guard.begin_safe()
    _, vent = over(guard, lambda t: {"pressure": float("nan") if t < 2.0 else 1e3})
    assert vent.confirmed
    assert rig.values("close") == []


def test_an_emergency_stop_while_it_vents_waits_for_no_ramp_and_latches():
    guard, rig = armed(RAMPED)
    guard.set("pressure", 300e3)
    guard.begin_safe()
    for step in range(9):
        guard.step_safe({"pressure": 300e3 - step * 5e3})
        guard.attend(guard.clock.now(), 20.0)
        assert guard.state is State.STOPPING
        guard.clock.wait_until(guard.clock.now() + 0.06)
        rig.high = step < 5
    assert rig.values("write")[-1] == ("write", "p", 0.0)
    assert rig.values("feed_watchdog")
    rig.reported.clear()
    _, vent = over(guard, lambda _: {"pressure": 1e3})
    guard.attend(guard.clock.now(), 20.0)
    assert rig.values("level") == [], "nothing waits any more"
    assert 'dac: the interlock "e-stop" is open (dac.in0)' in vent.actions
    assert guard.state is State.TRIPPED


def test_a_drive_that_was_stopped_is_not_ready_and_that_is_no_emergency_stop():
    guard, rig = armed(bench(safe_state=(SAFE[0], RAMP, LOOK)))
    guard.set("pressure", 100e3)
    rig.high = False
    guard.begin_safe()
    for step in range(4):
        guard.step_safe({"pressure": 100e3 - step * 10e3})
        guard.attend(guard.clock.now(), 20.0)
        guard.clock.wait_until(guard.clock.now() + 0.1)
    assert rig.values("level") == []
    assert rig.values("follow")


@pytest.mark.parametrize(
    ("changed", "result"),
    [({"range of in0": "1 V"}, "commanded"), ({"watchdog": 0.0, "uptime": 0.1}, "confirmed"), ({}, "confirmed")],
)
def test_a_gauge_whose_range_was_changed_confirms_nothing(changed, result):
    """It read 10 kPa of 300, and a restart or a watchdog that fired meanwhile changes no reading."""
    guard, rig = opened(PATIENT)
    rig.reports["range of in0"] = "10 V"
    guard.arm("run")
    guard.set("pressure", 300e3)
    rig.reports |= changed
    guard.begin_safe()
    took, vent = over(guard, lambda _: {"pressure": 10e3})
    assert (vent.result, took < 0.7) == (result, True), vent.actions
    assert any("its range of in0 was 10 V" in text for text in vent.actions) == (result == "commanded")


def test_a_gauge_that_does_not_say_how_it_measures_is_waited_for_and_believed():
    guard, rig = opened(PATIENT, threads=True)
    rig.reports["range of in0"] = "10 V"
    guard.arm("run")
    rig.wrong["held"] = hangs = threading.Event()
    guard.begin_safe()
    _, vent = over(guard, lambda _: {"pressure": 10e3}, step=0.02)
    hangs.set()
    assert vent.confirmed
