"""What goes wrong on the line: lost, late, doubled and hostile lines, a board that starts again, one that is no such board."""

import random
import time
from itertools import pairwise

import pytest
from pmabench_drivers.serial_line_daq import SerialLineDaq, encode

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.common import opened, timed
from tests.drivers.serial_line_daq.rigs import IDENTITY, LATE, Hand, board, collected, emulated, gather
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime


@pytest.fixture
def rig(tmp_path):
    with emulated(tmp_path / "board") as served, opened(board(served.address)) as device:
        device.arm_watchdog(1.0)
        yield served, device


def failure(device, within=2.0):
    """What `collect` raises within a time."""
    until = time.monotonic() + within
    while time.monotonic() < until:
        took, outcome = timed(device.collect)
        assert took < LATE
        if isinstance(outcome, Exception):
            return str(outcome)
        time.sleep(0.01)
    return ""


def sample(number, micros, state=1, counts=(1, 2, 3)):
    return encode("S", number, micros, state, *counts)


def streaming(hand, driver):
    """Let a board by hand begin to sample at 100 Hz: nothing is sent yet."""
    assert driver.start(100.0) == 100.0
    assert hand.heard[-1] == ("G", 10000)


def test_lost_samples_are_counted_and_their_gap_is_at_its_place():
    """Of 200 samples the numbers 50, 51 and 120 never arrive: two gaps, there, and nothing is closed up."""
    with Hand() as hand, opened(board(hand.address)) as driver:
        streaming(hand, driver)
        for number in range(200):
            if number not in {50, 51, 120}:
                hand.send(sample(number, number * 10000))
        times, _ = collected(driver, 197)
        steps = [later - earlier for earlier, later in pairwise(times)]
        assert {i: step for i, step in enumerate(steps) if step != 10_000_000} == {49: 30_000_000, 117: 20_000_000}
        assert driver.missed == 3


def test_noise_between_and_in_lines_costs_only_the_lines_that_it_hits():
    chance = random.Random(3)
    with Hand() as hand, opened(board(hand.address)) as driver:
        streaming(hand, driver)
        hit = set(chance.sample(range(1, 399), 60))
        for number in range(400):
            line = bytearray(sample(number, number * 10000, counts=(number, 2 * number, -number)))
            if number in hit:
                line[chance.randrange(len(line) - 1)] ^= 1 << chance.randrange(8)
            hand.send(bytes(line))
            if number % 40 == 0:
                hand.send(chance.randbytes(30) + b"\n")
                time.sleep(0.01)
        times, columns = collected(driver, 340)
        kept = [number for number in range(400) if number not in hit]
        assert [time // 10_000_000 for time in times] == kept
        assert columns["pressure"] == kept
        assert columns["force"] == [-number for number in kept]
        assert driver.missed == 60


def test_a_line_without_an_end_is_bounded():
    with Hand() as hand, opened(board(hand.address)) as driver:
        streaming(hand, driver)
        for _ in range(500):
            hand.send(b"S,1,2" * 40)
            time.sleep(0.0005)
        hand.send(b"\n" + sample(7, 7))
        assert len(collected(driver, 1)[0]) == 1


def test_a_board_that_starts_again_while_it_samples_is_an_error(rig):
    served, device = rig
    device.start(100.0)
    gather(device, 0.1)
    device.write("o0", 100.0)
    served.faults.set("reset")
    assert "no sample for 0.25 s" in failure(device)
    assert device.read_back("o0") == 0.0  # it woke up vented
    with pytest.raises(DeviceError, match="not armed"):
        device.feed_watchdog()


def test_samples_that_begin_at_zero_again_are_not_believed():
    with Hand() as hand, opened(board(hand.address)) as driver:
        streaming(hand, driver)
        for number in range(100, 110):
            hand.send(sample(number, number * 10000))
        assert len(collected(driver, 10)[0]) == 10
        for number in range(5):
            hand.send(sample(number, number * 10000))
        assert "do not fit" in failure(driver)
        assert "no sample" in failure(driver)


@pytest.mark.parametrize(("kind", "value"), [("lost", 1), ("truncated", 3), ("silence", 0)])
def test_a_board_that_says_nothing_readable_is_soon_an_error_and_then_comes_back(rig, kind, value):
    served, device = rig
    device.start(100.0)
    gather(device, 0.1)
    served.faults.set(kind, value)
    assert "no sample for 0.25 s" in failure(device)
    served.faults.set("clear")
    assert collected(device, 3)
    device.arm_watchdog(1.0)
    served.faults.set(kind, value)
    took, error = timed(device.write, "o0", 5.0)
    assert took < LATE
    assert "whether it took 5 is not known" in str(error)
    served.faults.set("clear")
    assert collected(device, 3)
    assert device.read_back("o0") == (0.0 if kind == "silence" else 5.0)


@pytest.mark.parametrize("kind", ["garbage", "double"])
def test_what_is_between_lines_and_lines_that_come_twice_do_no_harm(rig, kind):
    served, device = rig
    device.start(100.0)
    served.faults.set(kind)
    times, _ = collected(device, 30)
    assert len(set(times)) == len(times)
    for value in (1.0, 2.0, 3.0):
        device.write("o0", value)
        assert device.read_back("o0") == value


@pytest.mark.parametrize(("taken", "says"), [(True, None), (False, "did not answer to the command 5 and holds 2")])
def test_a_lost_answer_is_settled_by_what_the_board_holds_and_nothing_is_sent_twice(taken, says):
    held, sent = [2], []

    def reply(letter, number, values):
        if letter != "W":
            return None
        if len(values) == 2:
            sent.append(values[1])
            if taken:
                held[0] = values[1]
            return b""
        return encode("A", number, held[0])

    with Hand(reply) as hand, opened(board(hand.address)) as driver:
        took, outcome = timed(driver.write, "o0", 5.0)
    assert took < LATE
    assert sent == [5]
    assert (outcome is None) if says is None else says in str(outcome)


def test_late_answers_never_belong_to_another_question():
    """Each question's answer is its own count, and comes after up to 0.25 s: what a call returns is its own or nothing."""
    chance, asked, late = random.Random(9), [0], []

    def reply(letter, number, values):
        if letter != "W":
            return None
        asked[0] += 1
        late.append(encode("A", number, asked[0]))
        chance.shuffle(late)
        return b"".join(late.pop() for _ in range(len(late) - chance.randrange(2)))

    with Hand(reply) as hand, opened(board(hand.address)) as driver:
        answered = 0
        for _ in range(24):
            took, outcome = timed(driver.read_back, "o0")
            assert took < LATE
            if not isinstance(outcome, Exception):
                assert outcome == asked[0]
                answered += 1
        assert 4 < answered < 24


def test_hostile_replies_never_become_values():
    """Before the right answer come others: garbage, wrong checksums, other numbers, no numbers; sometimes none is right."""
    chance, truth = random.Random(21), [0]

    def reply(letter, number, values):
        if letter == "I":
            return None
        other = str(chance.randrange(1, 999_999_999))
        lie = chance.randrange(4096)
        data = chance.choice([
            b"", chance.randbytes(chance.randrange(60)) + b"\n", encode("A", other, lie), encode("E", other, "vented"),
            encode("A", number, lie)[:-3] + b"0\n", b"A,%s,%d\n" % (number.encode(), lie), encode("A", "", lie),
            encode("B", number, lie), encode("S", number, lie), encode("A"), b"\n\r\n" * 20, b"x" * 5000 + b"\n",
        ])  # fmt: skip
        truth[0] = chance.randrange(4096)
        kind = chance.random()
        if kind < 0.02:
            return data
        if kind < 0.1:
            return data + encode("A", number, chance.choice(["", "1.5", "-3", "nan", "1,2"]))
        return data + encode("A", number, truth[0])

    count = cases(300)
    with Hand(reply) as hand, opened(board(hand.address)) as driver:
        right = 0
        for _ in range(count):
            took, outcome = timed(driver.read_back, "o0")
            assert took < LATE
            if isinstance(outcome, Exception):
                assert isinstance(outcome, DeviceError)
                assert "did not answer" in str(outcome) or "a number is expected" in str(outcome)
            else:
                assert outcome == truth[0]
                right += 1
        assert right > 0.7 * count


@pytest.mark.parametrize(("identity", "says"), [
    (("other-daq", 1, *IDENTITY[2:]), 'is no "line-daq" of version 1'),
    (("line-daq", 2, *IDENTITY[2:]), 'is no "line-daq" of version 1'),
    (IDENTITY[:-1], 'is no "line-daq" of version 1'),
    ((*IDENTITY[:-1], "fast"), 'is no "line-daq" of version 1'),
    ((*IDENTITY[:4], 2, 1, 1, 1, 4095, 2000), 'has 2 count input(s), and "a2" is none'),
    ((*IDENTITY[:4], 3, 0, 1, 1, 4095, 2000), 'has 0 digital input(s), and "d0" is none'),
    ((*IDENTITY[:4], 3, 1, 1, 0, 4095, 2000), 'has 0 valve(s), and "v0" is none'),
    ((*IDENTITY[:-1], 0), "shortest period is 0 us"),
])  # fmt: skip
def test_a_board_that_is_not_what_the_bench_wants_is_not_opened(identity, says):
    with Hand(lambda letter, number, _values: encode("A", number, *identity) if letter == "I" else None) as hand:
        driver = SerialLineDaq(board(hand.address), RealClock())
        with pytest.raises(DeviceError) as error:
            driver.open()
        assert says in str(error.value)
        assert [letter for letter, *_ in hand.heard] == ["I"]


def test_nobody_there_and_somebody_who_only_babbles(tmp_path):
    with pytest.raises(DeviceError, match="cannot open"):
        SerialLineDaq(board(tmp_path / "nothing"), RealClock()).open()
    with Hand(lambda *_: b"login: \n") as hand:
        took, error = timed(SerialLineDaq(board(hand.address), RealClock()).open)
        assert "did not say who it is within 1.9 s at 500000 baud; the last thing heard was" in str(error)
        assert "login" in str(error)
        assert took < 2.5


def test_opening_moves_nothing_and_waits_for_a_board_that_is_starting():
    """An Arduino restarts when its port is opened, and says nothing meanwhile."""
    began = time.monotonic()

    def reply(letter, number, values):
        return b"" if time.monotonic() - began < 1.0 else None

    with Hand(reply) as hand, opened(board(hand.address)):
        assert {letter for letter, *_ in hand.heard} == {"I", "G"}
        assert hand.heard[-1] == ("G", 0)


def test_a_board_that_samples_already_is_taken_over(tmp_path):
    with emulated(tmp_path / "board") as served:
        with opened(board(served.address)) as first:
            first.start(500.0)
        with opened(board(served.address)) as second:
            second.start(50.0)
            times, _ = collected(second, 10)
            assert sum(later - earlier for earlier, later in pairwise(times)) > 0.15e9


def test_a_ramp_that_is_refused_is_an_error_once_and_samples_go_on(rig):
    from pmabench.bench.interface import Segment

    _served, device = rig
    device.disarm_watchdog()
    device.start(100.0)
    device.follow("o0", Segment("ramp", device._clock.now(), 0.0, target=4000.0, rate=100.0))
    assert "watchdog is not armed" in failure(device)
    device.write("o0", 0.0)
    assert failure(device, 0.6) == ""


@pytest.mark.slow
def test_the_plant_behind_the_emulator_does_what_the_board_is_asked_to(rig):
    """300 kPa and 58.86 N: 31.91 mm, the equilibrium of the plant's own example, and 0 after the valve is let go."""
    served, device = rig
    served.plant.load(58.86, 8.0)
    device.switch("v0", on=True)
    device.write("o0", 300.0)
    device.start(100.0)
    for _ in range(150):
        device.feed_watchdog()
        time.sleep(0.02)
        block = device.collect()
    assert block.columns["pressure"][-1] == pytest.approx(350.0, abs=1.0)  # counts of 1 kPa from -50 kPa
    assert block.columns["displacement"][-1] == pytest.approx(50 + 3191.0, abs=20.0)  # of 0.01 mm from -0.5 mm
    assert device.level("d0")
    served.plant.fail("e_stop_at")
    assert not device.level("d0")
    device.switch("v0", on=False)
    _, columns = gather(device, 0.9)
    assert columns["pressure"][-1] == pytest.approx(50.0, abs=2.0)
