"""The safe state: begun once, in order, carried on when an action fails, sent again until confirmed (S3, S4, P6)."""

import threading
import time
from dataclasses import replace
from math import inf

import pytest

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import Busy, DeviceError, LimitRefused, NotSent
from pmabench.bench.interface import ChannelRecord, DeviceRecord, SafeAction, Scale, TripRecord, ValveRecord
from pmabench.guard import course
from pmabench.guard.guard import Guard, State
from pmabench.guard.limits import refuse_outside
from pmabench.guard.owner import Call, Direct, Owner
from pmabench.guard.safe import LINGERS, STAYS
from tests.guard.rig import BENCH, DEVICE, DRIVE, DRIVER, OUTPUT, SAFE, Plain, Rig, armed, bench, opened

RAMP = SafeAction("ramp", "pressure", 0.0, 5.0, 100e3)
LOW = {"pressure": 5e3}


def advance(guard, seconds, latest=None):
    guard.clock.wait_until(guard.clock.now() + seconds)
    return guard.step_safe(latest or {})


def test_actions_go_out_in_the_declared_order_and_the_outcome_says_each():
    guard, rig = armed()
    guard.set("pressure", 300e3)
    rig.reported.clear()
    vent = guard.safe_state(lambda: LOW, why="test")
    assert rig.reported[:3] == [("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]
    assert rig.reported[3:] == [("read_back", "p"), ("is_on", "v")], "nothing is asked before all was commanded"
    assert vent.actions == ("stop displacement: sent", "set pressure: sent", "open dump_valve: sent",
                            "confirm pressure: 5 kPa, below 20 kPa")  # fmt: skip
    assert (vent.result, guard.state, guard.why) == ("confirmed", State.SAFE, "test")


def test_a_safe_ramp_begins_where_the_output_is_not_where_its_last_ramp_ends():
    guard, rig = armed(bench(safe_state=(RAMP, *SAFE)))
    guard.ramp("pressure", 0.0, 600e3, 10e3)
    guard.clock.wait_until(guard.clock.now() + 3.0)
    guard.begin_safe()
    guard.step_safe({})
    segment = rig.values("follow")[-1][2]
    assert segment.origin * OUTPUT.scale.slope == pytest.approx(30e3, abs=OUTPUT.scale.slope)
    assert (segment.target, segment.rate * OUTPUT.scale.slope) == (0.0, pytest.approx(100e3))


def test_a_safe_ramp_of_a_guard_that_comes_later_begins_at_what_the_device_holds():
    """Whoever commanded it is gone: the ramp is no step to its end."""
    guard, rig = opened(bench(safe_state=(RAMP, *SAFE)), forgiving=True)
    rig.at["p"] = lambda _now: OUTPUT.scale.to_raw(400e3)
    guard.begin_safe()
    assert advance(guard, 3.9) is None
    (segment,) = [reported[2] for reported in rig.values("follow")]
    assert segment.origin * OUTPUT.scale.slope == pytest.approx(400e3, abs=OUTPUT.scale.slope)
    assert segment.rate * OUTPUT.scale.slope == pytest.approx(100e3)
    assert rig.values("write") == []


def test_a_safe_ramp_out_of_a_sine_begins_on_the_sine():
    guard, rig = armed(bench(safe_state=(RAMP,)))
    guard.sine("pressure", 300e3, 100e3, 0.25, 10)
    guard.clock.wait_until(guard.clock.now() + 1.0)
    guard.begin_safe()
    guard.step_safe({})
    assert rig.values("follow")[-1][2].origin * OUTPUT.scale.slope == pytest.approx(400e3, abs=OUTPUT.scale.slope)


def test_courses_are_the_closed_forms():
    assert course.step(3.0)(9.0) == 3.0
    ramp = course.ramp(10.0, 1.0, 5.0, 2.0)
    assert [ramp(t) for t in (10.0, 11.0, 12.0, 99.0)] == [1.0, 3.0, 5.0, 5.0]
    sine = course.sine(10.0, 1.0, 2.0, 0.25, 2)
    assert [sine(t) for t in (9.0, 10.0, 11.0, 13.0, 18.0, 30.0)] == pytest.approx([1.0, 1.0, 3.0, -1.0, 1.0, 1.0])
    assert sine.crests(12.9) == pytest.approx([11.0, 13.0, 15.0])


@pytest.mark.parametrize(("crest", "value"), [(0.5, 15e-3), (1.5, 5e-3)])
def test_a_drive_that_holds_the_crest_of_a_sine_holds_what_was_commanded(crest, value):
    """Looked at every 37 ms the command never comes to its crest, and a good run ended by "it restarted"."""
    guard, rig = armed()
    guard.set("displacement", 10e-3)
    guard.sine("displacement", 10e-3, 5e-3, 0.5, 6)
    guard.clock.wait_until(guard.clock.now() + crest + 0.022)
    differs = guard.supervision.output_differs(DRIVE)
    rig.at["x"] = lambda _now: DRIVE.scale.to_raw(value)
    assert differs() == ""
    rig.at["x"] = lambda _now: DRIVE.scale.to_raw(value + 1e-6 * (1 if crest < 1 else -1))
    assert "the device holds" in differs()


def test_a_ramp_is_waited_for_and_a_hold_too():
    guard, rig = armed(bench(safe_state=(RAMP, SafeAction("hold", "", 0.0, 2.0), *SAFE[1:])))
    guard.set("pressure", 200e3)
    rig.reported.clear()
    guard.begin_safe()
    assert advance(guard, 1.9) is None
    assert rig.values("write", "switch") == []
    assert advance(guard, 0.2) is None  # the ramp took 2 s
    assert advance(guard, 1.9) is None
    assert rig.values("write", "switch") == []
    advance(guard, 0.2)
    assert rig.values("write", "switch") == [("write", "p", 0.0), ("switch", "v", False)]
    assert advance(guard, 0.1, LOW) is None
    assert advance(guard, STAYS, LOW).confirmed


def test_a_ramp_that_fails_goes_over_the_second_way_and_nothing_waits_for_it():
    guard, rig = armed(bench(safe_state=(RAMP, *SAFE)))
    guard.set("pressure", 200e3)
    rig.wrong["follow"] = "no answer"
    rig.reported.clear()
    guard.begin_safe()
    guard.step_safe({})
    assert rig.values("write", "switch") == [("write", "p", 0.0), ("switch", "v", False)]
    until = time.monotonic() + 5.0
    while not rig.values("rescue"):
        assert time.monotonic() < until
    assert rig.values("rescue") == [("rescue", "p", 0.0)]


def test_hurry_leaves_out_waits_and_nothing_else():
    guard, rig = armed(bench(safe_state=(RAMP, SafeAction("hold", "", 0.0, 2.0), *SAFE)))
    guard.set("pressure", 200e3)
    guard.begin_safe()
    guard.step_safe({})
    rig.reported.clear()
    guard.begin_safe(hurry=True)
    guard.step_safe({})
    commands = rig.values("write", "halt", "switch")
    assert commands == [("write", "p", 0.0), ("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]
    assert advance(guard, 0.1, LOW) is None
    assert advance(guard, STAYS, LOW).confirmed


def test_a_hurry_within_one_confirmation_leaves_the_last_one_to_be_judged():
    """40 kPa passed for "below 10 kPa": the look at "below 50 kPa", which a Ctrl-C had ended, stood for the last one."""
    looks = [SafeAction("confirm", "pressure", most, 5.0) for most in (50e3, 10e3)]
    guard, _ = armed(bench(safe_state=(*SAFE[:-1], looks[0], SafeAction("hold", "", 0.0, 1.0), looks[1])))
    guard.set("pressure", 200e3)
    guard.begin_safe()
    guard.step_safe({"pressure": 40e3})
    advance(guard, 0.1, {"pressure": 40e3})
    guard.begin_safe(hurry=1)
    assert advance(guard, 0.1, {"pressure": 40e3}) is None
    vents = [advance(guard, 0.5, {"pressure": 40e3}) for _ in range(20)]
    assert [vent.result for vent in vents if vent][:1] == ["commanded"]


PATIENT = (*SAFE[:-1], replace(SAFE[-1], within=60.0))


def test_a_second_signal_ends_the_wait_for_confirmations_and_a_first_one_does_not():
    guard, _ = armed(bench(safe_state=PATIENT))
    guard.set("pressure", 200e3)
    guard.begin_safe()
    guard.step_safe({})
    assert advance(guard, 15.0, HIGH) is None
    guard.begin_safe(hurry=1)
    assert advance(guard, 15.0, HIGH) is None
    guard.begin_safe(hurry=2)
    vent = advance(guard, 0.1, HIGH)
    assert vent.result == "commanded"
    assert vent.actions[-2:] == (
        "confirm pressure: 300 kPa, not below 20 kPa within 60 s",
        "waited 30.1 s, ended on request",
    )


def test_a_wait_that_the_bench_file_ends_was_not_ended_on_request():
    guard, _ = armed(bench(safe_state=SAFE))
    guard.set("pressure", 200e3)
    guard.begin_safe(hurry=2)
    guard.step_safe({})
    vent = advance(guard, SAFE[-1].within + 0.1, HIGH)
    assert vent.actions[-1] == "confirm pressure: 300 kPa, not below 20 kPa within 1 s"


def test_whoever_hurries_before_a_late_command_can_come_still_learns_that_the_bench_is_safe():
    guard, _ = armed(bench(safe_state=PATIENT))
    guard.set("pressure", 200e3)
    guard.begin_safe(hurry=2)
    guard.step_safe({})
    assert advance(guard, LINGERS - 0.1, HIGH) is None
    assert advance(guard, 0.1, LOW) is None
    assert advance(guard, STAYS, LOW).confirmed


def test_commands_are_sent_again_while_the_confirmation_is_waited_for():
    guard, rig = armed()
    rig.reported.clear()
    guard.begin_safe()
    for _ in range(9):
        assert advance(guard, 0.1, {"pressure": 200e3}) is None
    assert len(rig.values("switch")) == 2
    vent = advance(guard, 0.3, {"pressure": 200e3})
    assert vent.result == "commanded"
    assert vent.actions[-1] == "confirm pressure: 200 kPa, not below 20 kPa within 1 s"


def test_a_pressure_that_had_not_risen_yet_confirms_nothing():
    """A valve that opens 0.2 s after the command before, and sticks: low at first."""
    guard, _ = armed()
    guard.set("pressure", 400e3)
    begun = guard.clock.now()
    vent = guard.safe_state(lambda: {"pressure": 0.0 if wait(guard) < begun + 0.2 else 400e3})
    assert (vent.result, guard.state) == ("commanded", State.SAFE)
    assert vent.actions[-1] == "confirm pressure: 400 kPa, not below 20 kPa within 1 s"


def wait(guard):
    guard.clock.wait_until(guard.clock.now() + 0.05)
    return guard.clock.now()


def test_what_was_measured_once_confirms_once():
    guard, _ = armed()
    read = iter([LOW, LOW])
    vent = guard.safe_state(lambda: (wait(guard), next(read, {}))[1])
    assert vent.result == "commanded", "no sample has come since"


@pytest.mark.parametrize(("late", "believed"), [(0.2, True), (2.0, False)])
def test_samples_that_come_late_confirm_nothing(late, believed):
    guard = Guard(BENCH, VirtualClock(), threads=True)
    guard.open()
    guard.collect("dac")
    assert guard.latest.pop("pressure") == 0.0
    guard.clock.wait_until(3.0)
    Rig.made["dac"].late = late
    guard.collect("dac")
    assert ("pressure" in guard.latest) == believed
    guard.close()


def test_a_command_that_was_not_answered_is_overruled_until_it_cannot_come_any_more():
    """It is carried out 1.2 s later: the safe value is sent again after that, and nothing was confirmed before."""
    guard, rig = armed()
    rig.wrong["write"] = "did not answer"
    with pytest.raises(DeviceError):
        guard.set("pressure", 400e3)
    sent, held = guard.clock.now(), []
    del rig.wrong["write"]

    def measure():
        if wait(guard) >= sent + 1.2 and not held:
            held.append(len(rig.values("write")))
        return LOW

    vent = guard.safe_state(measure)
    assert vent.confirmed
    assert guard.clock.now() >= sent + LINGERS + STAYS
    assert len(rig.values("write")) > held[0] + 2


@pytest.mark.parametrize("value", [float("nan"), None, float("inf"), 20e3])
def test_nothing_but_a_number_below_confirms(value):
    guard, _ = armed()
    vent = guard.safe_state(lambda: {} if value is None else {"pressure": value})
    assert vent.result == "commanded"
    assert ("nothing measured" in vent.actions[-1]) == (value is None or value != value), "it said nan kPa"


@pytest.mark.parametrize(
    ("low", "trip", "value", "result"),
    [
        (-50e3, None, -50e3, "commanded"),
        (-50e3, None, -49e3, "confirmed"),
        (-50e3, -30e3, -40e3, "commanded"),
        (-50e3, -30e3, -29e3, "confirmed"),
        (-20e3, -30e3, -20e3, "commanded"),
        (0.0, None, 0.0, "confirmed"),
    ],
)
def test_what_a_broken_wire_reads_confirms_nothing(low, trip, value, result):
    """The end of a range or a low trip limit below zero; a range that begins at zero ends where the bench is empty."""
    channel = ChannelRecord("pressure", "pressure", "dac", "p_in", "float64", "Pa", Scale(1.0, 0.0), low, 1e6)
    trip_limit = TripRecord("pressure", trip, 650e3, 0.0, "vent")
    guard, _ = armed(bench(replace(DEVICE, channels=(channel,)), trips=(trip_limit,)))
    vent = guard.safe_state(lambda: {"pressure": value})
    assert vent.result == result
    assert ("broken wire" in vent.actions[-1]) == (result == "commanded")


@pytest.mark.parametrize(
    ("readings", "result"),
    [((0.0,), "commanded"), ((-5e4, 0.0), "commanded"), ((3e5, 0.0), "confirmed")],
)
def test_a_gauge_that_may_stand_still_confirms_once_it_has_read_high(readings, result):
    """Neither what it read all the time, nor what a broken wire reads in between, is a sign of life."""
    channel = replace(DEVICE.channels[0], low=-1e5)
    guard, _ = armed(bench(replace(DEVICE, channels=(channel, *DEVICE.channels[1:]))))
    guard.begin_safe(doubted=("elsewhere", "pressure"))
    left = list(readings)
    while (vent := advance(guard, 0.05, {**LOW, "pressure": left.pop(0) if len(left) > 1 else left[0]})) is None:
        assert guard.clock.now() < 60.0
    assert vent.result == result
    assert any("has not moved: it confirms nothing" in text for text in vent.actions) == (result == "commanded")


@pytest.mark.parametrize("call", ["write", "switch", "halt"])
def test_an_action_that_fails_goes_over_the_second_way_where_there_is_one(call):
    guard, rig = armed()
    rig.wrong[call] = "no answer"
    deadline = time.monotonic() + 5.0
    guard.begin_safe()
    while (vent := advance(guard, 0.001, LOW)) is None:
        assert time.monotonic() < deadline
    reported = next(text for text in vent.actions if {"write": "set", "switch": "open", "halt": "stop"}[call] in text)
    if call == "halt":
        assert reported == "stop displacement: failed (dac.displacement: no answer)" or "no answer" in reported
    else:
        assert reported.endswith("sent over the second way")
        assert rig.values("rescue") == [("rescue", {"write": "p", "switch": "v"}[call], 0.0)]


def test_all_ways_failing_is_a_failed_vent_and_the_rest_is_still_done():
    guard, rig = armed()
    rig.wrong |= {"write": "no answer", "rescue": "no answer either"}
    deadline = time.monotonic() + 5.0
    guard.begin_safe()
    while (vent := advance(guard, 0.001, LOW)) is None:
        assert time.monotonic() < deadline
    assert rig.values("switch")[0] == ("switch", "v", False)
    assert "set pressure: failed (dac: no answer either)" in vent.actions
    assert "set pressure: sent again" in vent.actions, "when it was opened anew"
    assert guard.state is State.TRIPPED


def test_devices_that_cannot_do_an_action_fail_it_and_stop_nothing():
    plain = replace(DEVICE, driver=f"{Plain.__module__}:Plain")
    guard = Guard(bench(plain, safe_state=(*SAFE[:3], RAMP, SafeAction("close", "dump_valve", 0.0, 0.2))), RealClock())
    guard.open()
    vent = guard.safe_state(dict)
    assert vent.result == "failed"
    assert [text.split(" (")[0] for text in vent.actions] == [
        "stop displacement: failed", "set pressure: failed", "open dump_valve: failed", "ramp pressure: failed",
        "close dump_valve: failed",
    ]  # fmt: skip


def test_a_device_that_was_not_opened_fails_and_stops_nothing():
    other = DeviceRecord("other", DRIVER, valves=(ValveRecord("supply", "other", "s", safe="closed"),))
    actions = (SafeAction("close", "supply", 0.0, 0.2), SafeAction("set", "nothing", 0.0, 0.2), *SAFE)
    guard, rig = opened(bench(devices=(DEVICE, other), safe_state=actions))
    del guard.devices["other"]
    vent = guard.safe_state(lambda: LOW)
    assert vent.actions[:2] == (
        "close supply: failed (other: is not open)",
        "set nothing: failed (nothing: is not open)",
    )
    assert rig.values("switch")[0] == ("switch", "v", False)


@pytest.mark.parametrize("tripped", [True, False])
def test_after_the_safe_state_only_the_safe_state_passes(tripped):
    guard, rig = armed()
    guard.set("pressure", 300e3)
    guard.safe_state(lambda: LOW, tripped=tripped)
    assert guard.state is (State.TRIPPED if tripped else State.SAFE)
    rig.reported.clear()
    for command in (
        lambda: guard.set("pressure", 0.0),
        lambda: guard.set("pressure", 100e3),
        lambda: guard.ramp("pressure", 0.0, 100e3, 1e3),
        lambda: guard.sine("displacement", 0.0, 0.0, 1.0, 1.0),
        lambda: guard.valves(closed=True),
        guard.release,
        guard.arm,
    ):
        with pytest.raises(LimitRefused):
            command()
    assert rig.reported == []
    guard.begin_safe(tripped=True)
    assert rig.reported == [("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]
    guard.step_safe({})
    assert guard.state is State.TRIPPED


def test_a_command_while_the_safe_state_is_under_way_is_refused():
    guard, rig = armed()
    guard.begin_safe()
    with pytest.raises(LimitRefused, match="stopping"):
        guard.set("pressure", 0.0)
    guard.begin_safe()
    assert rig.values("write") == [] or len(rig.values("write")) == 1


def test_the_valves_open_for_hands_and_close_again():
    guard, rig = armed()
    guard.valves(closed=False)
    guard.valves(closed=True)
    assert rig.reported == [("switch", "v", False), ("switch", "v", True)]


def test_the_watchdog_is_let_go_only_where_the_bench_is_confirmed_to_be_safe():
    guard, rig = armed()
    guard.safe_state(dict)
    guard.close()
    assert rig.values("disarm_watchdog") == []
    guard, rig = armed()
    guard.safe_state(lambda: LOW)
    rig.wrong["close"] = "no answer"
    guard.close()
    assert rig.values("disarm_watchdog") == [("disarm_watchdog",)]


def fed(guard, now=0.0):
    for record in guard.bench.devices:
        guard.supervision.feed(record, now)


def test_a_watchdog_that_has_bitten_is_noticed():
    guard, rig = armed()
    fed(guard, 0.0)
    rig.wrong["feed_watchdog"] = "its watchdog has vented"
    for tenth in (1, 2):  # one lost answer is no lost device
        fed(guard, tenth / 10)
    with pytest.raises(DeviceError, match="has vented"):
        fed(guard, 0.3)


# -- devices that hang ----------------------------------------------------------------------------------------------


def test_a_call_that_hangs_is_not_waited_for_and_the_vent_goes_round_it():
    guard, rig = armed(threads=True)
    released = rig.wrong["write"] = threading.Event()
    try:
        begin = time.monotonic()
        with pytest.raises(DeviceError, match=r"did not answer within 0.2 s"):
            guard.set("pressure", 300e3)
        with pytest.raises(DeviceError, match="has not answered yet"):
            guard.set("pressure", 300e3)
        guard.begin_safe(tripped=True)
        while not [reported for reported in rig.values("rescue") if reported[1] == "p"]:
            guard.step_safe({})
            assert time.monotonic() - begin < 5.0
        while not [reported for reported in rig.values("rescue") if reported[1] == "v"]:
            guard.step_safe({})
            assert time.monotonic() - begin < 5.0
        while guard.step_safe(LOW) is None:
            assert time.monotonic() - begin < 5.0
    finally:
        released.set()
    assert [reported for reported in rig.reported if reported[0] == "rescue"] == [
        ("rescue", "p", 0.0),
        ("rescue", "v", 0.0),
    ]
    deadline = time.monotonic() + 5.0
    while rig.values("write")[-1:] != [("write", "p", 0.0)]:
        assert time.monotonic() < deadline, "what was commanded last is the safe value"
    guard.close()


def test_a_hung_feed_is_not_piled_up():
    guard, rig = armed(threads=True)
    released = rig.wrong["feed_watchdog"] = threading.Event()
    for _ in range(50):
        fed(guard)
    released.set()
    guard.set("pressure", 1e3)
    assert len(rig.values("feed_watchdog")) == 1
    guard.close()


def test_an_owner_that_comes_back_can_be_asked_again():
    owner, released = Owner("x"), threading.Event()
    with pytest.raises(DeviceError, match="did not answer"):
        owner.call(lambda: released.wait(20.0), 0.01)
    assert owner.submit(lambda: 1).behind
    released.set()
    deadline = time.monotonic() + 5.0
    while True:
        try:
            assert owner.call(lambda: 7, 5.0) == 7
            break
        except DeviceError:
            assert time.monotonic() < deadline


@pytest.mark.parametrize("owner", [Owner("x"), Direct("x")])
def test_what_a_device_raises_is_a_device_error(owner):
    with pytest.raises(DeviceError, match="x: ZeroDivisionError: integer division or modulo by zero"):
        owner.call(lambda: 1 // 0, 5.0)
    with pytest.raises(LimitRefused, match="mine"):
        owner.call(lambda: (_ for _ in ()).throw(LimitRefused("mine")), 5.0)


def test_devices_that_answer_are_vented_while_another_one_hangs_in_its_opening(monkeypatch):
    monkeypatch.setattr("pmabench.guard.links.OPENS_WITHIN", 0.3)
    Rig.made.clear()
    released = threading.Event()
    hangs = DeviceRecord("hangs", DRIVER, options={"wrong": {"open": released}}, watchdog=1.0)
    dead = DeviceRecord("dead", "no_such:Driver", watchdog=1.0)
    guard = Guard(bench(devices=(hangs, dead, DEVICE)), RealClock(), threads=True, forgiving=True)
    began = time.monotonic()
    opening = threading.Thread(target=guard.open)
    opening.start()
    while "dac" not in Rig.made or len(Rig.made["dac"].reported) < 4:
        assert time.monotonic() - began < 5.0
    assert Rig.made["dac"].reported == [("open",), ("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]
    assert opening.is_alive(), "it did not wait for the one that hangs"
    opening.join()
    released.set()
    assert guard.describe().keys() == {"dac"} or guard.describe().keys() == {"dac", "hangs"}
    guard.close()


def test_a_device_of_several_actions_without_a_safe_start_is_only_opened():
    guard = Guard(bench(safe_state=(RAMP, *SAFE)), RealClock(), threads=True, forgiving=True)
    guard.open()
    assert Rig.made["dac"].reported == [("open",)]
    guard.close()


# -- commands -------------------------------------------------------------------------------------------------------


def test_a_name_that_is_no_output_is_refused():
    guard, _ = armed()
    with pytest.raises(LimitRefused, match='no output "presure"'):
        guard.set("presure", 0.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 21e-3])
def test_a_rate_that_is_none_or_too_high_is_refused(rate):
    guard, rig = armed()
    with pytest.raises(LimitRefused, match="cannot be ramped"):
        guard.ramp("displacement", 0.0, 10e-3, rate)
    assert rig.reported == []


@pytest.mark.parametrize(
    ("frequency", "cycles"), [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (float("nan"), 1.0), (1.0, float("inf"))]
)
def test_a_sine_that_is_none_is_refused(frequency, cycles):
    guard, rig = armed()
    with pytest.raises(LimitRefused, match="a sine needs"):
        guard.sine("pressure", 1e5, 1e4, frequency, cycles)
    assert rig.reported == []


def test_a_sine_that_moves_too_fast_is_refused():
    guard, rig = armed()
    with pytest.raises(LimitRefused, match="the sine moves at"):
        guard.sine("displacement", 0.0, 0.0 + 10e-3, 1.0, 1.0) if False else guard.sine(
            "displacement", 5e-3, 5e-3, 1.0, 1.0
        )
    assert rig.reported == []


def test_streams_hands_and_what_would_be_sent():
    guard, rig = armed()
    assert guard.links.stream("dac", 100.0) == 100.0
    rig.reads["pressure"] = 12.0
    assert guard.collect("dac").columns["pressure"][0] == 12.0
    assert guard.latest == {"pressure": 12.0}
    assert guard.links.stream("dac", 0.0) == 0.0
    assert guard.value_sent("pressure", 1.0) == 0.0
    from pmabench.bench.interface import Load

    guard.place(Load(10.0, 1.0))
    assert rig.values("place") == [("place", 10.0, 1.0)]
    for ask in (lambda: guard.collect("none"), lambda: guard.links.stream("none", 1.0)):
        with pytest.raises(DeviceError, match="takes no samples"):
            ask()


def test_an_empty_block_shows_nothing_new():
    guard, rig = armed()
    rig.collect = lambda: type("Empty", (), {"time": [], "columns": {}})()
    guard.collect("dac")
    assert guard.latest == {}


def test_the_bench_of_these_tests_is_sound():
    assert BENCH.devices == (DEVICE,)
    assert DEVICE.outputs == (OUTPUT, DRIVE)
    assert SAFE == BENCH.safe_state


# -- benches of several devices -------------------------------------------------------------------------------------


def test_each_device_is_asked_for_what_it_has_and_no_other():
    """A valve island without watchdog, a reader that the engine owns, a device without hands."""
    plain = f"{Plain.__module__}:Plain"
    reader = DeviceRecord("reader", DRIVER)
    island = DeviceRecord(
        "island", DRIVER, valves=(ValveRecord("supply", "island", "s", energised="open", safe="closed"),)
    )
    relay = DeviceRecord("relay", plain, valves=(ValveRecord("spare", "relay", "r"),))
    made = bench(devices=(reader, island, DEVICE), safe_state=(SafeAction("close", "supply", 0.0, 0.2), *SAFE))
    guard, rig = opened(made, threads=True)
    assert "reader" not in guard.devices
    guard.arm()
    assert ("switch", "s", True) in Rig.made["island"].reported, "the supply stands open in a run"
    fed(guard)
    rig.reported.clear()
    guard.valves(closed=False, only="dump_valve")
    assert rig.values("switch") == [("switch", "v", False)]
    assert len(Rig.made["island"].values("switch")) == 1
    guard.collect("dac")
    assert guard.step_safe({}) is None, "nothing has begun"
    vent = guard.safe_state(lambda: LOW, why="first")
    guard.begin_safe(why="second")
    assert (vent.result, guard.why) == ("confirmed", "first")
    assert Rig.made["island"].values("switch")[-1] == ("switch", "s", False)
    assert Rig.made["island"].values("feed_watchdog") == []
    guard.close()
    guard = Guard(bench(devices=(DEVICE, relay), safe_state=SAFE), RealClock(), threads=True, forgiving=True)
    guard.open()
    from pmabench.bench.interface import Load

    guard.place(Load(1.0, 0.1))
    assert guard.safe_state(lambda: LOW).confirmed
    guard.close()


def test_a_watchdog_of_a_device_that_has_none_is_not_fed():
    guard = Guard(bench(replace(DEVICE, driver=f"{Plain.__module__}:Plain")), RealClock())
    guard.open()
    fed(guard)


def test_a_value_that_the_device_would_round_beyond_its_limit_is_refused():
    """Below the safe value it is rounded upwards, here by up to 15 kPa."""
    narrow = replace(OUTPUT, low=190e3, safe=201e3, high=201.2e3, resolution=100.0)
    refuse_outside(narrow, (194e3, 195e3), inf)
    with pytest.raises(LimitRefused, match="is outside 190 kPa"):
        refuse_outside(narrow, (200.6e3,), inf)
    with pytest.raises(LimitRefused, match="is outside 190 kPa"):
        refuse_outside(narrow, (189e3,), inf)


def test_a_safe_state_of_unknown_outputs_is_no_hindrance_where_nobody_answers():
    guard = Guard(
        bench(safe_state=(SafeAction("set", "nothing", 0.0, 0.2), *SAFE)), RealClock(), threads=True, forgiving=True
    )
    guard.open()
    assert Rig.made["dac"].reported == [("open",), ("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]
    guard.close()


def test_a_channel_whose_name_shows_no_unit_is_shown_in_si():
    guard, _ = armed(bench(safe_state=(SafeAction("confirm", "unheard_of", 2.0, 1.0),)))
    assert guard.safe_state(lambda: {"unheard_of": 1.5}).actions[0].startswith("confirm unheard_of: 1.5")


# -- a safe state without effect (S13) --------------------------------------------------------------------------------

HIGH = {"pressure": 3e5}


def until_over(guard, seconds, latest):
    deadline = guard.clock.now() + 60.0
    while (vent := advance(guard, seconds, latest)) is None:
        assert guard.clock.now() < deadline
    return vent


def test_what_is_acknowledged_and_not_carried_out_goes_over_the_second_way():
    guard, rig = armed()
    guard.set("pressure", 300e3)
    rig.ignores = True
    assert guard.feeds(DEVICE)
    guard.begin_safe()
    vent = until_over(guard, 0.01, LOW)
    assert rig.values("rescue") == [("rescue", "p", 0.0), ("rescue", "v", 0.0)]
    assert {"set pressure: sent over the second way", "open dump_valve: sent over the second way"} < {*vent.actions}
    assert guard.feeds(DEVICE)
    assert not rig.values("close")


def test_a_device_that_carries_out_nothing_is_left_to_its_watchdog_and_asked_again_later():
    guard, rig = armed(bench(safe_state=(*SAFE[:3], SafeAction("confirm", "pressure", 20e3, 10.0))))
    guard.links.stream("dac", 20.0)
    guard.set("pressure", 300e3)
    rig.ignores = "both ways"
    guard.begin_safe()
    assert guard.feeds(DEVICE)
    advance(guard, 0.01, HIGH)
    advance(guard, 0.01, HIGH)
    assert not guard.feeds(DEVICE)
    assert rig.reported[-1] == ("close",)
    gone = guard.clock.now()
    while Rig.made["dac"] is rig:
        assert advance(guard, 0.05, HIGH) is None
    assert 1.5 <= guard.clock.now() - gone < 2.5, "its watchdog of 1 s had its time"
    again = Rig.made["dac"]
    commands = [("halt", "x"), ("write", "p", 0.0), ("switch", "v", False)]
    assert again.reported == [("open",), ("start", 20.0), *commands], "at once, and without questions"
    vent = until_over(guard, 0.5, LOW)
    assert ("write", "p", 0.0) in again.reported or vent.confirmed
    assert 'set pressure: failed ("pressure" was commanded to 0 kPa and the device holds 300 kPa' in "".join(
        vent.actions
    )
    assert "dac: its line is closed, so that its watchdog takes over" in vent.actions


@pytest.mark.parametrize(("second", "refuses"), [(NotSent("dac", "exception 4"), True), ("no answer", False)])
def test_a_command_that_is_refused_in_an_answer_closes_the_line_and_one_without_an_answer_does_not(second, refuses):
    """A regulator put to LOCAL was commanded 92 times, and each answer fed its watchdog: 300 kPa until all were gone."""
    guard, rig = armed(bench(safe_state=(*SAFE[:3], SafeAction("confirm", "pressure", 20e3, 5.0))))
    rig.wrong |= {"write": NotSent("dac", "exception 4"), "rescue": second}
    guard.begin_safe()
    advance(guard, 0.05, {"pressure": 3e5})
    assert bool(rig.values("close")) == refuses
    for leaking in (2.9e5, 2.8e5, 2.7e5):  # that is no effect
        advance(guard, 0.1, {"pressure": leaking})
    assert rig.values("close")


@pytest.mark.parametrize(("lasts", "result"), [(1, "confirmed"), (2, "commanded")])
def test_a_device_that_is_busy_is_asked_a_second_time_before_its_line_is_closed(lasts, result):
    """Busy for 0.3 s it was left to its watchdog, 0.75 s with a muscle that is full."""
    guard, rig = armed(bench(replace(DEVICE, outputs=(OUTPUT,)), safe_state=SAFE[1:]))
    guard.set("pressure", 300e3)
    rig.wrong |= dict.fromkeys(("write", "rescue"), Busy("dac", "exception 6"))
    guard.begin_safe()
    advance(guard, 0.01, HIGH)
    assert not rig.values("close")
    if lasts == 1:
        rig.wrong.clear()
    advance(guard, 0.11, HIGH)
    advance(guard, 0.01, HIGH)
    assert bool(rig.values("close")) == (lasts == 2)
    vent = None
    while vent is None:
        vent = advance(guard, 0.1, LOW)
    assert vent.result == result
    assert guard.state is State.TRIPPED


def test_a_repeat_that_is_answered_after_others_of_its_device_counts_as_busy(monkeypatch):
    """A driver asks a busy device for 0.18 s, and two commands after each other for 0.37 s: that was no answer, the
    repeats fed the watchdog until the wait was over, and the muscle was full for 4 s in place of 2.
    """
    guard, _ = armed(bench(replace(DEVICE, outputs=(OUTPUT,)), safe_state=SAFE[1:]))
    guard.set("pressure", 300e3)
    waiting: list[tuple[float, Call]] = []

    def submit(_device, act):
        waiting.append((guard.clock.now(), Call(act)))
        return waiting[-1][1]

    monkeypatch.setattr(guard.links, "submit", submit)
    monkeypatch.setattr(guard, "_rescue", lambda _action: None)
    guard.begin_safe()
    took = 0
    while not guard._given_up and took < 60:
        advance(guard, 0.05, {})  # its gauge is silent, too
        took += 1
        for call in (call for since, call in waiting if guard.clock.now() - since >= 0.37 and not call.done.is_set()):
            call.error = Busy("dac", "exception 6")
            call.done.set()
    assert took * 0.05 < 1.5


def test_a_device_that_stays_busy_without_a_watchdog_is_opened_again():
    """At every second repeat it counted as one that does not answer for the first time."""
    device = replace(DEVICE, outputs=(OUTPUT,), watchdog=0.0)
    guard, rig = armed(bench(device, safe_state=(SAFE[1], SafeAction("confirm", "pressure", 20e3, 5.0))))
    guard.set("pressure", 300e3)
    rig.wrong |= dict.fromkeys(("write", "rescue"), Busy("dac", "exception 6"))
    rig.reported.clear()
    guard.begin_safe()
    refusing = []
    while not rig.values("close") and len(refusing) < 20:
        assert advance(guard, 0.11, HIGH) is None
        refusing.append("pressure" in guard._safe.refusing)
    assert 7 <= len(refusing) <= 11, "after 0.8 s"
    assert refusing == sorted(refusing), "it changes its mind"
    advance(guard, 0.3, HIGH)
    assert Rig.made["dac"] is not rig
    assert ("write", "p", 0.0) in Rig.made["dac"].reported


def test_a_device_that_cannot_be_opened_again_is_tried_again():
    guard, rig = armed()
    guard.set("pressure", 300e3)
    rig.ignores = "both ways"
    guard.begin_safe()
    advance(guard, 0.01, HIGH)
    advance(guard, 0.01, HIGH)
    guard.links._bench = replace(guard.bench, devices=(replace(DEVICE, driver="nothing:There"),))
    for _ in range(40):
        guard.links._clock.wait_until(guard.clock.now() + 0.1)
        guard.links.open_again(lambda _name: [])
    assert "dac" not in guard.links.devices
    guard.links._bench = guard.bench
    for _ in range(40):
        guard.links._clock.wait_until(guard.clock.now() + 0.1)
        guard.links.open_again(lambda _name: [])
    assert "dac" in guard.links.devices


def test_a_pressure_that_does_not_fall_is_no_effect_and_one_that_falls_is():
    slow = bench(safe_state=(*SAFE[:3], SafeAction("confirm", "pressure", 20e3, 10.0)))
    guard, rig = armed(slow)
    guard.set("pressure", 300e3)
    guard.begin_safe()
    for _ in range(6):
        advance(guard, 0.1, HIGH)
    assert guard.feeds(DEVICE)
    for _ in range(3):
        advance(guard, 0.1, HIGH)
    assert not guard.feeds(DEVICE)
    assert rig.reported[-1] == ("close",)
    guard, rig = armed(slow)
    guard.begin_safe()
    for step in range(60):
        advance(guard, 0.1, {"pressure": 3e5 * 0.99**step})
        assert guard.feeds(DEVICE), step


def test_a_device_without_a_watchdog_keeps_its_line_and_gets_the_commands_again():
    guard, rig = armed(bench(replace(DEVICE, watchdog=0.0)))
    guard.set("pressure", 300e3)
    rig.ignores = "both ways"
    guard.begin_safe()
    vent = until_over(guard, 0.1, HIGH)
    assert len([reported for reported in rig.values("write") if reported[1] == "p"]) >= 2
    assert not rig.values("close")
    assert vent.result == "failed"


def test_a_ramp_and_a_hold_that_go_on_are_fed():
    guard, _ = armed(bench(safe_state=(RAMP, SafeAction("hold", "", 0.0, 2.0), *SAFE)))
    guard.set("pressure", 300e3)
    guard.begin_safe()
    for step in range(45):
        advance(guard, 0.1, {"pressure": max(1e3, 3e5 - step * 10e3)})
        assert guard.feeds(DEVICE)


def test_what_a_hung_line_cannot_say_is_not_held_against_the_second_way():
    guard, rig = armed(threads=True)
    guard.set("pressure", 300e3)
    rig.wrong["write"] = hangs = threading.Event()
    guard.begin_safe()
    vent = until_over(guard, 0.02, LOW)
    hangs.set()
    assert "set pressure: sent over the second way" in vent.actions


def test_an_acknowledged_command_of_which_nobody_knows_whether_it_is_held_is_not_called_sent():
    guard, rig = armed(threads=True)
    guard.set("pressure", 300e3)
    rig.wrong |= {"is_on": (hangs := threading.Event()), "rescue": "no second way"}
    guard.begin_safe()
    vent = until_over(guard, 0.02, LOW)
    hangs.set()
    assert "open dump_valve: failed (dac: no second way)" in vent.actions


def test_a_question_that_fails_is_asked_again_before_a_command_over_the_second_way_is_called_sent():
    """Its new connection may end a question under way: a valve that did not obey was called sent."""
    guard, rig = armed()
    guard.set("pressure", 300e3)
    rig.ignores, rig.wrong["is_on"] = "both ways", "the connection was closed"
    guard.begin_safe()
    for _ in range(3):
        advance(guard, 0.05, LOW)
    del rig.wrong["is_on"]
    vent = until_over(guard, 0.05, LOW)
    assert any(text.startswith("open dump_valve: failed") for text in vent.actions), vent.actions


def test_a_command_that_failed_latches_even_where_the_pressure_has_gone():
    """S7: the next run must not begin with a dump valve that did not obey."""
    guard, rig = armed()
    rig.wrong |= {"switch": "no answer", "rescue": "no answer either"}
    guard.begin_safe()
    vent = until_over(guard, 0.01, LOW)
    assert vent.result == "commanded"
    assert guard.state is State.TRIPPED


def test_a_value_from_before_the_line_was_closed_is_said_with_its_age():
    guard, _ = armed(bench(safe_state=(*SAFE[:3], SafeAction("confirm", "pressure", 20e3, 5.0))))
    guard.begin_safe()
    for _ in range(9):
        advance(guard, 0.1, HIGH)
    vent = until_over(guard, 0.1, {})
    assert "confirm pressure: 300 kPa 4.3 s ago, not below 20 kPa within 5 s" in vent.actions
