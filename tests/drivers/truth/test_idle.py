"""An emulated plant that nobody has looked at for long is at the present at once, and no less right for it."""

import os
import time
from itertools import pairwise

import pytest
from pmabench_drivers.emulator import Emulator
from pmabench_drivers.emulator.plant import KEPT, RealPlant

from pmabench.base.clock import RealClock
from tests.drivers.truth.rigs import driver, records

SOON = 0.05
"""Half of the shortest time that a driver waits for an answer [s]."""


class Skipping(RealClock):
    """A clock that stands still until it is put forward: how fast this machine is changes nothing."""

    ahead = 0.0

    def now(self):
        return self.ahead


def plant(**options):
    clock = Skipping()
    return RealPlant(preset="ideal", clock=clock, **options), clock


def took(act):
    """How long it keeps this thread's processor [s]: another program's turn does not count."""
    begin = time.thread_time()
    act()
    return time.thread_time() - begin


@pytest.mark.parametrize("muscle", ["paper0", "real"])
def test_the_first_look_after_ten_minutes_is_as_fast_as_any(muscle):
    still, clock = plant(plant=muscle)
    found = []
    for _ in range(3):
        clock.ahead += 600.0
        found.append(took(still.quantities))
    assert min(found) < SOON, found
    clock.ahead += 600.0
    assert took(lambda: still.command(2e5)) < SOON


def test_what_was_under_way_is_where_it_would_have_come():
    """A drive at 1 mm/s for 20 s, and a regulator that was commanded before: as one that was looked at all the time."""
    slow, clock = plant(driven=True)
    slow.switch(on=True)
    slow.command(2e5)
    slow.drive(0.02, 0.001)
    clock.ahead += 12.0
    found = slow.quantities()
    assert found["displacement"] == pytest.approx(0.012, abs=2e-4)
    assert found["pressure"] == pytest.approx(2e5, rel=1e-6)
    clock.ahead += 600.0
    assert slow.quantities()["displacement"] == pytest.approx(0.02, abs=1e-9)


@pytest.mark.parametrize("muscle", ["paper0", "real"])
def test_a_rest_gives_the_same_as_looking_all_the_time(muscle):
    seldom, late = plant(plant=muscle)
    often, clock = plant(plant=muscle)
    for each in (seldom, often):
        each.switch(on=True)
        each.load(60.0, 8.0)
        each.command(2e5)
    late.ahead += 10.0
    for _ in range(100):
        clock.ahead += 0.1
        often.quantities()
    one, other = seldom.quantities(), often.quantities()
    assert one["displacement"] > 0.01
    assert one == pytest.approx(other, rel=1e-4, abs=1e-6)


def test_samples_of_the_last_seconds_are_there_each_at_its_time():
    """A device that samples by its own clock finds the past two seconds after a rest, 1 ms apart."""
    moving, clock = plant(driven=True)
    moving.drive(0.05, 0.001)
    clock.ahead += 20.0
    moving.quantities()
    now = clock.start + clock.now()
    places = [moving.at(now - back)["displacement"] for back in (1.5, 1.0, 0.5)]
    assert [b - a for a, b in pairwise(places)] == pytest.approx([5e-4, 5e-4], abs=5e-6)
    assert KEPT >= 2.0


def test_a_fault_that_began_meanwhile_has_happened():
    full, clock = plant()
    full.switch(on=True)
    full.command(2e5)
    clock.ahead += 5.0
    assert full.quantities()["pressure"] == pytest.approx(2e5, rel=1e-3)
    full.fail("burst_at")
    clock.ahead += 600.0
    assert full.quantities()["pressure"] == pytest.approx(0.0, abs=1.0)


@pytest.mark.realtime
def test_an_emulator_that_nobody_asks_uses_little_and_answers_at_once(tmp_path):
    """Eight seconds of a rest in real time, of which the plant's thread makes nothing that a driver would notice."""
    [record] = records(tmp_path, "labjack")
    emulator = Emulator([record], preset="bench")
    try:
        before = sum(os.times()[:2])
        time.sleep(8.0)
        used = (sum(os.times()[:2]) - before) / 8.0
        behind = emulator.plant._clock.now() - emulator.plant._mock._link.time
        first = took(emulator.plant.quantities)
        with driver(record) as device:
            assert device.read_back("DAC0") == 0.0
    finally:
        emulator.close()
    assert used < 0.10, f"{used:.1%} of a processor"
    assert behind < KEPT + 1.5
    assert first < SOON
