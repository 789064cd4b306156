"""Polls at absolute deadlines: none is lost when the computer stands still for a few, and what is lost is counted."""

import threading
from math import floor

import pytest
from pmabench_drivers.shared import link as polling

from pmabench.base.errors import DeviceError

RATE = 256.0
"""A power of two, so that periods and seconds are exact: five deadlines are made up [Hz]."""


SHORT = 1 / 64
"""How long a tick takes [periods]."""


class Waited(threading.Event):
    """A clock that counts periods, and is waited on; `busy[k]` is how long the computer does something else before tick k."""

    def __init__(self, busy, slow, ticks):
        super().__init__()
        self.time, self._busy, self._slow, self._ticks, self.taken = 0.0, busy, slow, ticks, []

    def wait(self, timeout=None):
        self.time += timeout * RATE + self._busy.get(len(self.taken), 0.0)
        return self.is_set()

    def now(self):
        return self.time / RATE

    def tick(self):
        self.time += self._slow.get(len(self.taken), SHORT)
        self.taken.append(self.time)
        if len(self.taken) == self._ticks:
            self.set()


def polled(*, busy=(), slow=(), ticks=40):
    halt = Waited(dict(busy), dict(slow), ticks)
    cycle = polling.Cycle("test", halt.tick, halt)
    cycle._run(RATE, halt)
    return halt.taken, cycle.missed


@pytest.mark.parametrize(("long", "lost"), [(0.5, 0), (1.5, 0), (4.5, 0), (5.5, 0), (6.5, 1), (20.5, 15)])
def test_five_deadlines_are_made_up_and_older_ones_counted(long, lost):
    taken, missed = polled(busy={10: long})
    assert missed == lost
    assert floor(taken[-1]) + 1 == len(taken) + lost
    assert taken[-1] - floor(taken[-1]) == pytest.approx(SHORT)


@pytest.mark.parametrize("long", [1.25, 2.5, 30.25])
def test_a_device_slower_than_its_rate_rests_until_the_next_deadline(long):
    taken, missed = polled(slow=dict.fromkeys(range(40), long))
    begun = [time - long for time in taken]
    assert begun == [floor(time) for time in begun]
    assert missed == begun[-1] + floor(long) - 39


class Still:
    """A clock that stands where it is put."""

    time = 0.0

    def now(self):
        return self.time


@pytest.mark.parametrize("once", [False, True])
def test_ticks_that_fail_are_reported_once_they_have_failed_for_a_quarter_of_a_second_without_a_good_one(once):
    clock, wrong = Still(), DeviceError("gauge", "no answer")
    cycle = polling.Cycle("test", lambda: None, clock)
    for clock.time, failure in ((0.0, wrong), (0.2, None), (0.24, wrong), (0.49, wrong)):
        cycle.note(failure)
        cycle.refuse("gauge", once=once)
    clock.time = 0.5
    with pytest.raises(DeviceError, match="no answer"):
        cycle.refuse("gauge", once=once)
    cycle.note(wrong)
    if once:
        cycle.refuse("gauge", once=True)
    else:
        with pytest.raises(DeviceError, match="no answer"):
            cycle.refuse("gauge")
    cycle.note(None)
    cycle.refuse("gauge", once=once)


def test_a_thread_that_has_ended_against_its_will_is_reported():
    cycle = polling.Cycle("test", lambda: None, Still())
    cycle.broken = ZeroDivisionError("division by zero")
    with pytest.raises(DeviceError, match="stepping broke off: division by zero"):
        cycle.refuse("gauge", "stepping")
