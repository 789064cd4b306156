"""Telegram 111 as words written out by hand, and the path of a sine through a drive with perfect manners or none."""

import math
from itertools import pairwise

import pytest
from pmabench_drivers.festo_cmmt import telegram as t
from pmabench_drivers.festo_cmmt.telegram import Path

from pmabench.bench.interface import Segment


def test_a_command_is_the_words_that_the_drive_expects():
    command = t.Command(on=True, task=True, target=-70000, velocity=95, override=0x2000)
    # bits 0 to 6 and 10; MDI, absolute, continuous; target and velocity low word first; 100 % acceleration
    assert command.words() == [0x047F, 0x9100, 0, 0, 0x2000, 0xEE90, 0xFFFE, 95, 0, 0x4000, 0x4000]
    assert t.Command(on=True, stop=True).words()[0] == 0x042F  # the task is rejected, the power stays on
    assert t.Command(stop=True).words()[0] == 0x042A  # a quick stop, and no power after it
    assert t.Command(acknowledge=True).words()[0] == 0x04BE


def test_a_status_is_read_from_the_words_that_the_drive_shows():
    words = [0x2A07, 0, 0, 0, 0, 0xEE90, 0xFFFE, 0, 0, 126, 0] + [0] * 17
    status = t.Status.of(words)
    assert (status.position, status.fault) == (-70000, 126)
    assert status.has(t.ENABLED)
    assert status.has(t.STOPPED)
    assert not status.has(t.FAULT)
    assert status.refusal() == ""


@pytest.mark.parametrize(
    ("word", "words"),
    [
        (0x0A08, "reports fault 126: it could not follow"),
        (0x0800, "gives no control to the network"),
        (0x0200, "is not homed"),
    ],
)
def test_each_refusal_has_its_reason(word, words):
    assert words in t.Status(word, 0, 126).refusal()


@pytest.mark.parametrize("wanted", [0.5, 1.0, 2.5, 9.99, 10.0, 94.2477, 500.0])
def test_velocity_and_override_make_any_speed(wanted):
    velocity, override = t.speed(wanted)
    assert isinstance(velocity, int)
    assert 0 < override <= 0x4000
    assert velocity * override / 0x4000 == pytest.approx(wanted, rel=1e-4)


class Drive:
    """Goes to its target at its velocity, less `loss`; commands come `late` seconds after they were made."""

    def __init__(self, loss=0.0):
        self.x, self.target, self.velocity, self.loss = 10000.0, 10000.0, 0.0, loss

    def run(self, time):
        way = self.velocity * (1 - self.loss) * time
        left = self.target - self.x
        self.x = self.target if way >= abs(left) else self.x + math.copysign(way, left)


def driven(loss=0.0, late=lambda k: 0.0, frequency=1.0, cycles=8, stalls=(), fastest=math.inf):
    """Positions of a drive in steps of 1 ms, and the sine's; a cycle is 10 ms, its command comes late(k) after.

    Nothing is done in the cycles of `stalls`.
    """
    now, drive, places, wanted = 0.0, Drive(loss), [], []
    path = Path(lambda: now, fastest)
    path.rest_at(10000.0)
    segment = Segment("sine", 0.0, 10000.0, amplitude=5000.0, frequency=frequency, cycles=cycles)
    path.follow(segment)
    coming = []
    for ms in range(round(1000 * cycles / frequency) + 200):
        now = ms / 1e3
        if ms % 10 == 0 and ms // 10 not in stalls:
            piece = path.next(0.01)
            if piece is not None:
                coming.append((ms + late(ms // 10), piece))
            path.seen(drive.x, now)
        while coming and coming[0][0] <= ms:
            drive.target, drive.velocity = coming.pop(0)[1]
        drive.run(0.001)
        places.append(drive.x)
        wanted.append(path.now())
    return places, wanted


def error(places, wanted, first=2000):
    return max(abs(x - y) for x, y in zip(places[first:-300], wanted[first:-300], strict=True))


def test_a_perfect_drive_follows_the_sine_between_the_cycles_too():
    places, wanted = driven()
    chord = 5000 * (2 * math.pi * 0.01) ** 2 / 8  # an arc of the sine over its chord
    assert error(places, wanted) < chord + 5000 * 2 * math.pi * 0.001 + 1  # and what it moves in a step
    assert places[-1] == pytest.approx(10000.0, abs=0.5)


def test_late_commands_are_made_up_and_never_lead_beyond_the_crests():
    places, wanted = driven(late=lambda k: 8 if k % 7 == 3 else 2)
    assert max(places) <= 15000
    assert min(places) >= 5000
    assert error(places, wanted) < 5000 * 2 * math.pi * 0.015
    assert places[-1] == pytest.approx(10000.0, abs=0.5)


def test_what_a_drive_loses_by_its_acceleration_is_made_up():
    places, _wanted = driven(loss=0.1, frequency=0.5, cycles=6)
    settled = places[6000:-1200]
    assert max(settled) > 14800
    assert min(settled) < 5200
    assert max(places) <= 15000
    assert places[-1] == pytest.approx(10000.0, abs=1)


@pytest.mark.parametrize("fastest", [math.inf, 40e3])
def test_after_a_stall_it_catches_up_as_fast_as_the_sine_and_the_actuator_allow(fastest):
    """A drive of 100 mm/s was sent on at 719 mm/s after 0.12 s."""
    places, wanted = driven(stalls=range(200, 222), fastest=fastest)
    own = 5000 * 2 * math.pi
    assert max(abs(b - a) for a, b in pairwise(places)) <= min(1.5 * own, fastest) / 1000 + 0.1
    assert error(places, wanted, 3000) < 400, "caught up within 0.8 s"
    assert places[-1] == pytest.approx(10000.0, abs=0.5)


def test_a_ramp_is_one_target_at_its_start():
    now = 0.0
    path = Path(lambda: now)
    path.rest_at(0.0)
    path.follow(Segment("ramp", 0.5, 0.0, 10000.0, rate=20000.0))
    assert path.next(0.01) is None
    assert path.now() == 0.0
    now = 0.5
    assert path.next(0.01) == (10000.0, 20000.0)
    assert path.next(0.01) is None
    now = 0.75
    assert path.now() == pytest.approx(5000.0)
