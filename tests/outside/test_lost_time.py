"""Engine and guard that lose time, both killed, and a guard that goes on after the seal (S6, S12, R12)."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from tests.outside.campaign import table
from tests.outside.freezes import LENGTHS, freeze, kill_both, seal
from tests.outside.harness import once_begun
from tests.reliability.cases import cases

pytestmark = [pytest.mark.realtime, pytest.mark.singly, pytest.mark.timeout(3600)]
MOST = 20
ON_DEMAND = cases(0) > 0


def tried(what, per_commit, folder, record_property):
    """Each case in a folder of its own, some side by side; nothing may be wrong with any."""
    count = min(cases(per_commit), MOST)
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda number: once_begun(partial(what, number), folder / str(number)), range(count)))
    print(f"\n{table(results)}")
    record_property("cases", count)
    record_property("failures", sum(bool(result.wrong) for result in results))
    assert not [result.wrong for result in results if result.wrong]


@pytest.mark.parametrize("length", LENGTHS if ON_DEMAND else LENGTHS[:2])
def test_no_run_goes_on_after_a_freeze_of_both(length, tmp_path, record_property):
    tried(partial(freeze, length), 2 if length == 0.9 else 1, tmp_path, record_property)


@pytest.mark.parametrize("length", LENGTHS[:2] if ON_DEMAND else LENGTHS[1:2])
def test_no_run_goes_on_where_a_message_was_waiting_during_the_freeze(length, tmp_path, record_property):
    tried(partial(freeze, length, pending=True), 1, tmp_path, record_property)


def test_the_device_vents_when_both_are_killed(tmp_path, record_property):
    tried(kill_both, 1, tmp_path, record_property)


def test_a_stopped_guard_is_ended_and_the_sealed_run_is_whole(tmp_path, record_property):
    tried(seal, 2, tmp_path, record_property)
