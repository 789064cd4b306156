"""GAP stands only before a sample where samples are missing, LATE where a sample came late: by hand, and however cut."""

from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.engine.source import Spacing
from pmabench.store.records import Flag

G, L = int(Flag.GAP), int(Flag.LATE)
RATE = 100.0


def flags(periods, cuts=()):
    """The flags of samples at `periods` [1/RATE], which come in blocks; the last one is settled."""
    times = [round(1e9 / RATE * p) for p in periods]
    edges = [0, *sorted(min(cut, len(times)) for cut in cuts), len(times)]
    spacing, found = Spacing(RATE), []
    for first, last in pairwise(edges):
        before, block = spacing.look(times[first:last])
        found[len(found) - len(before) :] = map(int.__or__, found[len(found) - len(before) :], before)
        found += block
    last = spacing.settle()
    return found[: len(found) - len(last)] + list(map(int.__or__, found[len(found) - len(last) :], last))


CASES = {
    "in time": ([0, 1, 2, 3], [0, 0, 0, 0]),
    "one is missing": ([0, 1, 3, 4, 5], [0, 0, G, 0, 0]),
    "five are missing": ([0, 1, 7, 8], [0, 0, G, 0]),
    "one is late by 0.6": ([0, 1, 2.6, 3, 4], [0, 0, L, 0, 0]),
    "one is late by 0.95": ([0, 1, 2.95, 3, 4], [0, 0, L, 0, 0]),
    "two on end are late by 0.6": ([0, 1, 2.6, 3.6, 4, 5], [0, 0, L, L, 0, 0]),
    "one is missing and the next late by 0.3": ([0, 1, 3.3, 4, 5], [0, 0, G, 0, 0]),
    "one is late by 0.6, the next missing": ([0, 1, 2.6, 4, 5], [0, 0, L, G, 0]),
    "two come together after a silence": ([0, 1, 3.6, 3.61, 4, 5], [0, 0, L, L, 0, 0]),
    "two are made up after a stall": ([0, 1, 4.1, 4.15, 4.2, 5, 6], [0, 0, L, L, 0, 0, 0]),
    "three are made up, each late": ([0, 1, 5.7, 5.8, 5.9, 6.0, 6.1, 7], [0, 0, L, L, L, L, 0, 0]),
    "one is missing, one made up": ([0, 1, 4.1, 4.15, 5, 6], [0, 0, G, 0, 0, 0]),
    "six are missing, four made up": ([0, 1, 12.1, 12.2, 12.3, 12.4, 12.5, 13], [0, 0, G, L, L, L, 0, 0]),
    "the last are made up": ([0, 1, 4.1, 4.15], [0, 0, G, 0]),
    "late by 0.4": ([0, 1, 2.4, 3, 4], [0, 0, 0, 0, 0]),
    "the last is late": ([0, 1, 2.6], [0, 0, L]),
    "before the last one is missing": ([0, 1, 3], [0, 0, G]),
}


@pytest.mark.parametrize("name", CASES)
@settings(max_examples=30)
@given(cuts=st.lists(st.integers(0, 6), max_size=6))
def test_each_sample_has_the_flag_that_is_true(name, cuts):
    periods, reported = CASES[name]
    assert flags(periods, cuts) == reported


@given(data=st.data())
def test_polls_at_absolute_deadlines_are_distinguished_from_missing_ones(data):
    """Any polls late by less than 0.9 periods or missing, one of either kind followed by two in time."""
    periods, reported, k = [0.0, 1.0], [0, 0], 1
    for kind, late in data.draw(st.lists(st.tuples(st.sampled_from("ml"), st.floats(0.55, 0.9)), max_size=8)):
        k += 2 if kind == "m" else 1
        periods += [k + (0.0 if kind == "m" else late), k + 1.0, k + 2.0]
        reported += [G if kind == "m" else L, 0, 0]
        k += 2
    cuts = data.draw(st.lists(st.integers(0, len(periods)), max_size=10))
    assert flags(periods, cuts) == reported


@given(stalls=st.lists(st.tuples(st.integers(5, 30), st.floats(1.0, 12.0)), max_size=6), data=st.data())
def test_polls_of_a_computer_that_stalls_are_missing_only_where_they_were_not_made_up(stalls, data):
    """The rule of `drivers` at 200 Hz: four deadlines are made up at once, 0.03 periods apart; older ones are missed."""
    periods, reported, k = [0.0], [0], 0
    for even, stall in stalls:
        periods += [k + i + 1.0 for i in range(even)]
        reported += [0] * even
        k += even
        now, lost = k + 1 + stall, max(0, int(stall) - 4)
        periods.append(now)
        k += 1
        reported.append(G if lost else L)
        k += lost
        while now + 0.03 > k + 1:
            now, k = now + 0.03, k + 1
            periods.append(now)
            reported.append(L if now - k > 0.5 else 0)
    periods += [k + 1.0, k + 2.0]
    reported += [0, 0]
    found = flags(periods, data.draw(st.lists(st.integers(0, len(periods)), max_size=10)))
    assert [bool(f & G) for f in found] == [bool(f & G) for f in reported]
    assert sum(bool(f & L) for f in found) == pytest.approx(sum(bool(f & L) for f in reported), abs=len(stalls))


@pytest.mark.parametrize("off", [0.98, 0.9999, 1.0001, 1.02])
def test_a_device_at_another_rate_than_it_says_is_not_flagged(off):
    jitter = np.random.default_rng(1).normal(0.0, 0.03, 2000)
    assert not any(flags(np.arange(2000) * off + jitter))


def test_as_many_samples_are_missing_as_between_the_gaps():
    """What is flagged explains where all deadlines have gone."""
    there = np.random.default_rng(2).random(3000) > 0.1
    there[:2] = True
    periods = np.flatnonzero(there)
    found = flags(periods)
    assert reduce(int.__or__, found) == G
    assert [bool(flag) for flag in found[1:]] == (np.diff(periods) > 1).tolist()


@given(data=st.data())
def test_blocks_that_come_as_arrays_are_flagged_as_sample_by_sample(data):
    """Where all came in time a block is looked at at once; what it carries on to the next one must be the same."""
    steps = data.draw(st.lists(st.sampled_from([0.1, 0.8, 1.0, 1.0, 1.0, 1.2, 1.3, 1.6, 2.0, 2.7]), max_size=30))
    times = np.cumsum(np.rint(1e9 / RATE * np.array([0.0, *steps])), dtype=np.int64)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(times)), max_size=6)))
    whole, single = Spacing(RATE), Spacing(RATE)
    for first, last in pairwise([0, *cuts, len(times)]):
        block = times[first:last]
        before, found = whole.look(block)
        assert (before, found or [0] * len(block)) == single.look(block.tolist())
        assert whole.open == single.open
    assert whole.settle() == single.settle()
