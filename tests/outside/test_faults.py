"""Faults of a regulator that shares nothing with the project, while it is under pressure; its log is the judge (S11, S13)."""

import os

import pytest

from tests.conftest import commit_number
from tests.outside.campaign import campaign, table
from tests.outside.kinds import KINDS
from tests.reliability.cases import VARIABLE

pytestmark = [pytest.mark.realtime, pytest.mark.alone]  # it asserts within how many seconds a bench is empty
SIDE_BY_SIDE = 3
ALL = tuple(dict.fromkeys(kind.name for kind in KINDS))
ALWAYS = ("restart", "watchdog-off", "set-point", "ignore-all", "echo", "silence", "nan")
IN_TURN = 5
"""Of the other kinds every commit tries one in so many, by its hash."""


def names_of_this_commit():
    """All on demand; else those that are always tried, and some of the others."""
    others = [name for name in ALL if name not in ALWAYS]
    return ALL if VARIABLE in os.environ else (*ALWAYS, *others[commit_number() % IN_TURN :: IN_TURN])


NAMES = names_of_this_commit()


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Each kind once with every commit, as often as its row says on demand."""
    each = None if VARIABLE in os.environ else 1
    found = campaign(each, set(NAMES), SIDE_BY_SIDE, tmp_path_factory.mktemp("faults"))
    print(f"\n{table(found)}")
    return found


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.timeout(3600)
def test_the_bench_is_vented_and_nothing_is_pressurised_again(name, results, record_property):
    some = [result for result in results if result.kind == name]
    wrong = [f"{result.protocol}: {'; '.join(result.wrong)}" for result in some if result.wrong]
    record_property("cases", len(some))
    record_property("failures", len(wrong))
    assert some
    assert not wrong
