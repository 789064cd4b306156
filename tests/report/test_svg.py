"""Drawings in few letters: every point stays where it was, within half a hundredth of a point of print."""

import re

import numpy as np
import pytest

from pmabench.plotting.svg import shortened, symbol_parts


def places(path):
    """Ends of all pieces of a path, absolute; written anew here, for M, L, l and z."""
    here = start = np.zeros(2)
    found = []
    for command, numbers in re.findall(r"([MLlz])([^MLlz]*)", path):
        values = np.array([float(n) for n in re.findall(r"-?\d*\.?\d+", numbers)]).reshape(-1, 2)
        for point in values if command != "z" else [start]:
            here = point + here if command == "l" else point
            found += [tuple(here)] if command != "z" else []
            start = here if command == "M" else start
    return np.array(found)


def test_a_path_by_differences_ends_where_it_did():
    """A thousand roundings do not add up."""
    points = np.cumsum(np.random.default_rng(1).normal(0, 0.3333, (1000, 2)), axis=0)
    path = "M " + " L ".join(f"{x:.6f} {y:.6f}" for x, y in points)
    short = shortened(path)
    assert np.abs(places(short) - points).max() <= 0.0051
    assert len(short) < 0.5 * len(path)


def test_gaps_and_closed_ends_are_kept():
    path = "M 1.5 2 L 3 2 L 3 4 z M 10 10 L 12 12 L 13 12 z L 11 10 M 0 0 L 2 0"
    assert shortened(path) == "M1.5 2l1.5 0 0 2zM10 10l2 2 1 0zl1 0M0 0l2 0"
    assert places(shortened(path)) == pytest.approx(places(path))


@pytest.mark.parametrize(("text", "angle"), [
    ("psi [deg]", True), ("phi, psi [deg]", True), ("phi = 3 deg, psi = -3 deg", True), ("psi", True),
    ("25 psi", False), ("25 psi, or kPa", False), ("kPa called psi", False), ("[psi]", False), ("kPa, psi", False),
])  # fmt: skip
def test_psi_is_an_angle_or_a_unit_of_pressure(text, angle):
    assert (("symbol", "ψ") in symbol_parts(text)) is angle
