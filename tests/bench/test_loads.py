"""Loads are what hanger and plates can make: held against every combination, tried one by one."""

import re
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmabench.bench.session import Stack

PLATES = st.lists(st.tuples(st.integers(1, 3), st.sampled_from([0.25, 0.5, 1.0, 1.25, 2.5, 4.9, 5.0])), max_size=4)


def every_load(hanger, plates):
    combinations = product(*(range(count + 1) for count, _ in plates))
    return {0.0} | {hanger + sum(n * each for n, (_, each) in zip(c, plates, strict=True)) for c in combinations}


@given(st.sampled_from([0.3, 1.1]), PLATES.filter(bool), st.integers(0, 400).map(lambda n: n * 0.05))
def test_a_load_can_be_made_when_some_combination_makes_it(hanger, plates, mass):
    stack, loads = Stack(hanger, plates), every_load(hanger, plates)
    assert stack.can_make(mass) == any(abs(load - mass) <= 1e-3 for load in loads)
    near = stack.around(mass)
    if not stack.can_make(mass):
        below = max((load for load in loads if load < mass), default=None)
        above = min((load for load in loads if load > mass), default=None)
        assert near == pytest.approx([load for load in (below, above) if load is not None])


@given(st.sampled_from([0.3, 1.1]), PLATES.filter(bool))
def test_the_plates_named_are_there_and_make_the_load(hanger, plates):
    stack = Stack(hanger, plates)
    for load in every_load(hanger, plates) - {0.0}:
        used = [(int(n), float(each)) for n, each in re.findall(r"(\d+) x ([\d.]+) kg", stack.text(load))]
        assert hanger + sum(n * each for n, each in used) == pytest.approx(load, abs=1e-6)
        for each in {each for _, each in used}:
            assert sum(n for n, e in used if e == each) <= sum(n for n, e in plates if e == each)


def test_the_heaviest_plate_first_is_not_always_the_way():
    stack = Stack(1.0, [(1, 5.0), (4, 3.0)])
    assert stack.can_make(7.0)
    assert stack.text(7.0) == "hanger 1 kg + 2 x 3 kg = 7 kg"


def test_plates_that_are_not_given_forbid_only_less_than_the_hanger():
    stack = Stack(1.1, [])
    assert stack.can_make(0.0)
    assert stack.can_make(6.37)
    assert stack.around(0.5) == [0.0, 1.1]


def test_a_hostile_stack_ends():
    stack = Stack(0.1, [(999, 0.0101 + 0.0007 * n) for n in range(40)])
    assert stack.can_make(0.1)
