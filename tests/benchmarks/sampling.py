"""One loop at 500 Hz in an interpreter of its own: `absolute` deadlines, or a `relative` sleep after each sample."""

import json
import sys
import threading
import time

from pmabench_drivers.shared.link import Cycle

from pmabench.base.clock import RealClock

RATE = 500.0


def absolute(seconds):
    """Times of the samples [s] and deadlines that were missed; as the polled drivers do it."""
    clock, taken = RealClock(), []
    cycle = Cycle("poll", lambda: taken.append(clock.now()), clock)
    cycle.start(RATE)
    time.sleep(seconds)
    cycle.stop()
    return taken, cycle.missed


def relative(seconds):
    """The same with a sleep of a period less the time that the sample took: errors add up."""
    clock, taken, wait = RealClock(), [], threading.Event()
    while clock.now() < seconds:
        began = clock.now()
        taken.append(began)
        wait.wait(max(0.0, 1 / RATE - (clock.now() - began)))
    return taken, 0


if __name__ == "__main__":
    times, missed = {"absolute": absolute, "relative": relative}[sys.argv[1]](float(sys.argv[2]))
    sys.stdout.write(json.dumps({"times": times, "missed": missed}))
