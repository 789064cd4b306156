"""GAP stands only before a sample where samples are missing, LATE where a sample came late: by hand, and however cut."""

from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmabench.engine.flags import Spacing
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
        if found:
            found[-1] |= before
        found += block
    found[-1] |= spacing.settle()
    return found


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
    "late by 0.4": ([0, 1, 2.4, 3, 4], [0, 0, 0, 0, 0]),
    "the last is late": ([0, 1, 2.6], [0, 0, L]),
    "before the last one is missing": ([0, 1, 3], [0, 0, G]),
}


@pytest.mark.parametrize("name", CASES)
@given(cuts=st.lists(st.integers(0, 6), max_size=6))
def test_each_sample_has_the_flag_that_is_true(name, cuts):
    periods, told = CASES[name]
    assert flags(periods, cuts) == told


@given(data=st.data())
def test_polls_at_absolute_deadlines_are_told_apart_from_missing_ones(data):
    """Any polls late by less than 0.9 periods or missing, one of either kind followed by two in time."""
    periods, told, k = [0.0, 1.0], [0, 0], 1
    for kind, late in data.draw(st.lists(st.tuples(st.sampled_from("ml"), st.floats(0.55, 0.9)), max_size=8)):
        k += 2 if kind == "m" else 1
        periods += [k + (0.0 if kind == "m" else late), k + 1.0, k + 2.0]
        told += [G if kind == "m" else L, 0, 0]
        k += 2
    cuts = data.draw(st.lists(st.integers(0, len(periods)), max_size=10))
    assert flags(periods, cuts) == told


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
