"""One owner for a device, whatever its bench is called; a lock and a latch for each name, in any script (S14)."""

import time
from contextlib import ExitStack

import pytest

from tests.outside.harness import Run, eventually, pmabench, regulator, write_bench
from tests.reliability.cases import cases

pytestmark = [pytest.mark.realtime, pytest.mark.singly]
NAMES = (
    ("банк-1", "банк-2"), ("東", "西"), ("bench a", "bench-a"), ("Bench", "bench"), ("μ", "µ"), ("e\u0301", "é"),
    ("台", "台 "), ("..", "."), ("x" * 200 + "1", "x" * 200 + "2"), ("a/b", "a\\b"), ("😀", "😁"), ("con", "nul"),
)  # fmt: skip
"""Names that differ in little; those that a bench file may not have at all are refused when it is read."""
ON_DEMAND = cases(0) > 0
"""Whether all is tried; with every commit some of it is."""
WAYS = ("another port of the device", "the same address", "another name of the computer")


@pytest.fixture
def benches(tmp_path):
    """Runs on bench files of one state folder; all is killed in the end."""
    with ExitStack() as stack:

        def device():
            return stack.enter_context(regulator(tmp_path))

        def begin(name, address, on=None, protocol="holds", folder=None):
            bench = write_bench(tmp_path / (folder or f"bench-{time.monotonic_ns()}"), name, address)
            made = Run(bench, protocol, tmp_path / "state", on)
            stack.callback(made.kill)
            return made

        yield device, begin


def armed(device):
    """Wait until a run has the valve of the device closed."""
    eventually(lambda: device.state()["closed"], so="the bench is armed")


@pytest.mark.parametrize("way", WAYS if ON_DEMAND else WAYS[:2])
def test_one_device_has_one_owner_under_two_names(way, benches):
    """The second is refused with the owner named, and nothing of what it sent was a command."""
    device, begin = benches
    one = device()
    address = {
        "the same address": one.address,
        "another name of the computer": f"localhost:{one.port}",
        "another port of the device": f"127.0.0.1:{one.other_port}",
    }[way]
    first = begin("first rig", one.address, one)
    first.pressurised()
    owners = {line["who"] for line in one.lines("write")}
    second = begin("second rig", address).end()
    assert second["exit_code"] == 4, second
    assert "first rig" in second["why"], second
    assert str(first.pid("guard")) in second["why"], second
    assert {line["who"] for line in one.lines("write")} == owners, "the second has commanded something"
    assert first.process.poll() is None
    assert one.state()["pressure"] > 100.0
    assert pmabench(first.state, "vent", "first rig").returncode == 0
    assert first.end()["status"] == "aborted"
    again = begin("second rig", address, one)
    armed(one)
    again.kill()


@pytest.mark.parametrize("pair", NAMES if ON_DEMAND else NAMES[:2], ids=ascii)
def test_names_that_differ_in_one_character_share_no_latch(pair, benches):
    """An unclean end of one refuses that one alone, and only its own reset lets it go."""
    device, begin = benches
    devices = [device(), device()]
    first = begin(pair[0], devices[0].address, devices[0])
    if first.process.poll() is None:
        eventually(lambda: devices[0].state()["closed"] or first.process.poll() is not None, so="it is armed")
    if first.process.poll() is not None:  # a name that no bench may have
        assert first.end()["exit_code"] == 3, first.end()
        return
    guard = first.pid("guard")
    first.kill()
    assert guard
    eventually(lambda: devices[0].lines("watchdog"), so="the device's watchdog ends")
    second = begin(pair[1], devices[1].address, devices[1])
    eventually(lambda: devices[1].state()["closed"] or second.process.poll() is not None, so="the other is armed")
    assert second.process.poll() is None, f"an unclean end of {pair[0]!r} refused {pair[1]!r}: {second.end()}"
    second.process.terminate()
    assert second.end()["exit_code"] == 143
    reset = ["--reset", "--operator", "me", "--because", "looked at"]
    state = first.state
    pmabench(state, "vent", pair[1], *reset)
    refused = begin(pair[0], devices[0].address).end()
    assert refused["exit_code"] == 5, f"a reset of {pair[1]!r} let {pair[0]!r} go: {refused}"
    assert "tripped" in refused["why"]
    eventually(lambda: not list(state.glob("*/guard.json")), so="its guard ends")
    done = pmabench(state, "vent", pair[0], *reset)
    assert done.returncode == 0, done
    again = begin(pair[0], devices[0].address, devices[0])
    armed(devices[0])
    again.kill()


def test_a_reset_by_a_word_that_means_two_benches_lets_no_other_go(benches):
    """One is called "rig"; the other's file is, and has another name."""
    device, begin = benches
    devices = [device(), device()]
    first = begin("alpha", devices[0].address, devices[0], folder="rig")
    renamed = first.folder / "rig.yaml"
    first.kill()
    (first.folder / "bench.yaml").rename(renamed)
    runs = [
        Run(renamed, "holds", first.state, devices[0]),
        begin("rig", devices[1].address, devices[1]),
    ]
    for one, run in zip(devices, runs, strict=True):
        armed(one)
        run.kill()
    for one in devices:
        eventually(lambda one=one: one.lines("watchdog"), so="the device's watchdog ends")
    pmabench(first.state, "vent", "rig", "--reset", "--operator", "me", "--because", "looked at rig")
    refused = Run(renamed, "holds", first.state)
    outcome = refused.end()
    refused.kill()
    assert outcome["exit_code"] == 5, f"a reset of the bench rig let the bench alpha go: {outcome}"
