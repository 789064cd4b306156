"""When a device had a command: between when it was sent and when it answered."""

import pytest

from pmabench.analysis.shared.skew import off
from pmabench.engine.commanded import Commander
from pmabench.store.reader import open_run
from tests.calls import call

TOOK = 0.12


@pytest.fixture
def run(tmp_path, monkeypatch):
    send = Commander.set

    def slowly(self, output, value):
        """A device that answers late, and has it then."""
        self._clock.wait_until(self._clock.now() + TOOK)
        return send(self, output, value)

    monkeypatch.setattr(Commander, "set", slowly)
    call("run", "contraction-relaxation", "--bench", "mock-ideal", "--specimen", "mas-20-250-paper0", "--yes", "-q",
         "--out", tmp_path, "--set", "sweep.repeat.count=1", "--set", "sweep.matrix.load=[6 kg]",
         "--set", "sweep.matrix.pressure=[200 kPa, 500 kPa]")  # fmt: skip
    (folder,) = tmp_path.iterdir()
    return open_run(folder)


def test_a_command_is_read_back_half_way_and_known_to_half_of_it(run):
    sent = [event.t for event in run.events if event.kind == "command" and event.data.get("trial") == 0]
    read = [command.t for command in run.trials[0].commands]
    assert read == pytest.approx([t + TOOK / 2 for t in sent])
    assert off([run], "pressure") == pytest.approx(TOOK / 2)


def test_the_dead_time_holds_the_truth(run):
    """The pressure follows the bench's dead time after the device had the command, at the end of the wait."""
    command = run.trials[0].commands[0]
    moved = run.trials[0].channels["pressure"] > 1e3
    after = float(run.trials[0].t[moved.argmax()]) - command.t
    assert 0 < after - TOOK / 2 < 0.1
