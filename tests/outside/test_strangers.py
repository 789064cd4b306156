"""Strangers on the guard's port: no effect on a run, and no false word about a vent (S15)."""

import re
import threading
import time

import pytest

from tests.outside.campaign import safe_lines
from tests.outside.harness import eventually, pmabench, regulator, run
from tests.outside.strangers import STRANGERS, WAYS, false_guard
from tests.reliability.cases import cases

pytestmark = [pytest.mark.realtime, pytest.mark.singly]
LASTS = 1.5
"""How long each stranger is there [s]."""
SAMPLES = 0.15
"""Longest time between two samples that no limit of the bench minds [s]; an undisturbed run may have longer ones."""


@pytest.mark.timeout(3600)
def test_a_run_does_not_notice_strangers(tmp_path, record_property):
    """The device sees how often it is read: no longer gap than without strangers; and a vent is as fast as ever."""
    count = min(cases(1), 10)
    record_property("cases", count * len(STRANGERS))
    wrong = []
    for number in range(count):
        left = list(STRANGERS)
        while left:
            folder = tmp_path / f"{number}-{len(left)}"
            with regulator(folder) as device, run(device, folder) as going:
                wrong += _one_after_the_other(device, going, left)
                if not left:
                    _vents_among_strangers(device, going)
    record_property("failures", len(wrong))
    assert not wrong


def _one_after_the_other(device, going, left):
    """Take strangers from `left` until none is left or one ends the run; what they did."""
    wrong = []
    going.pressurised()
    device.ask(mark=True)
    time.sleep(2 * LASTS)
    undisturbed = device.state()["longest"]
    most = max(SAMPLES, 2 * undisturbed)
    port = going.guard["port"]
    while left:
        name, moment = left.pop(0), time.monotonic()
        device.ask(mark=True)
        STRANGERS[name](port, LASTS)
        longest = device.state()["longest"]
        print(f"{name}: longest time without a sample {longest:.3f} s; undisturbed {undisturbed:.3f} s")
        if going.process.poll() is not None or safe_lines(device, moment):
            return [*wrong, f"{name}: ended the run: {going.end()['why']}"]
        if longest > most:
            wrong.append(f"{name}: {longest:.3f} s without a sample; undisturbed {undisturbed:.3f} s")
    return wrong


def _vents_among_strangers(device, going):
    port = going.guard["port"]
    crowd = [
        threading.Thread(target=STRANGERS[name], args=(port, 6.0))
        for name in ("1,000 idle connections", "64 MB of JSON")
    ]
    for one in crowd:
        one.start()
    time.sleep(1.5)
    moment = time.monotonic()
    done = pmabench(going.state, "vent", "outside")
    first = eventually(lambda: safe_lines(device, moment), so="the vent")[0]["t"]
    print(f"vent among strangers: commanded after {first - moment:.3f} s")
    assert first - moment < 2.0  # the start of Python and of its modules on a machine that is busy with the crowd
    assert done.returncode == 0, done
    assert device.state()["pressure"] < 20.0
    assert going.end()["status"] == "aborted"
    for one in crowd:
        one.join()


@pytest.mark.parametrize("way", WAYS if cases(0) else ("framed", "echo"))
def test_a_false_guard_confirms_nothing(way, tmp_path):
    """Both are killed and somebody else listens on the guard's port: only the device's own value counts."""
    with regulator(tmp_path) as device, run(device, tmp_path) as going:
        eventually(lambda: device.state()["closed"], so="the bench is armed")
        guard = going.guard
        going.kill("guard", "engine")
        eventually(lambda: device.lines("watchdog"), so="the device's watchdog ends")
        with false_guard(guard["port"], way) as heard:
            moment = time.monotonic()
            done = pmabench(going.state, "vent", "outside")
            commanded = safe_lines(device, moment)
            assert ("confirmed" not in done.stdout) or commanded, f"said, and the device has received nothing: {done}"
            assert done.returncode == 0, f"the device is there, and empty: {done}"
            assert commanded
            device.inject("refuse-connections")
            reset = ["--reset", "--operator", "me", "--because", "a stranger said so"]
            for more in ([], reset):
                done = pmabench(going.state, "vent", "outside", *more)
                assert done.returncode != 0, done
                assert not re.search(r"(?<!not )\bconfirmed\b", done.stdout), done
            device.clear()
        secrets = [value.encode() for value in guard.values() if isinstance(value, str) and len(value) >= 16]
        assert secrets
        assert not any(secret in piece for secret in secrets for piece in heard), "a stranger was given the secret"
        with run_again(going, device) as again:
            refused = again.end()
        assert refused["exit_code"] == 5, refused
        assert "tripped" in refused["why"]


def run_again(going, device):
    """The same bench once more, with the same state."""
    return run(device, going.folder.parent)
