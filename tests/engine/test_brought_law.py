"""A law of another package, found by an entry point of the group `pmabench.laws`, runs in a plan inside its range."""

import pytest

from pmabench.base import system
from pmabench.base.errors import UsageError
from pmabench.engine.executor import Executor
from pmabench.engine.laws import LAWS, law_of
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.protocol.plan import Seek
from tests.engine.benches import mounted, one_trial

LAW = """
class Greedy:
    'Asks for twice the pressure at each sample, for half a second.'

    def __init__(self, *, start):
        self.command, self.done, self.begun = start, False, None

    def update(self, t, values):
        self.begun = t if self.begun is None else self.begun
        self.done, self.command = t - self.begun >= 0.5, 2 * self.command
        return self.command

    def result(self):
        return {"asked": self.command, "command": 0.0}
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    (tmp_path / "greedy_law.py").write_text(LAW)
    about = tmp_path / "greedy-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: greedy\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[pmabench.laws]\ngreedy = greedy_law:Greedy\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        system.installed.cache_clear()
        yield
    system.installed.cache_clear()


@pytest.mark.usefixtures("package")
def test_it_runs_and_cannot_leave_the_range_of_its_step(tmp_path):
    step = Seek("greedy", "greedy", "pressure", 0.0, 2e5, 5.0, {"start": 1e3})
    sent = []

    def procedure(executor):
        send = executor.guard.set
        executor.guard.set = lambda name, value: sent.append(value) or send(name, value)
        Executor.run(executor)

    outcome = run_plan(one_trial(step), mounted(), ConfirmedBeforehand(), out=None, procedure=procedure)
    [found] = [data["result"] for kind, _, data in outcome.events if kind == "found"]
    assert outcome.status == "finished", outcome.why
    assert found["asked"] > 1e9
    assert max(sent) == 2e5


def test_an_unknown_law_is_named_with_the_nearest():
    with pytest.raises(UsageError, match='no installed package has a law "rely"; did you mean "relay"'):
        law_of("rely")


@pytest.mark.parametrize("name", sorted(LAWS))
def test_every_law_that_ships_is_there(name):
    assert callable(law_of(name))
