"""Drawings in few letters: every point stays where it was, within half a hundredth of a point of print."""

import re

import numpy as np
import pytest

from pmabench.plotting.svg import lean, shortened


def places(path):
    """Ends of all pieces of a path, absolute; written anew here, for M, l, q, c and z."""
    here = start = np.zeros(2)
    found = []
    for command, numbers in re.findall(r"([MLQClqcz])([^MLQClqcz]*)", path):
        values = np.array([float(n) for n in re.findall(r"-?\d*\.?\d+", numbers)]).reshape(-1, 2)
        size = {"m": 1, "l": 1, "q": 2, "c": 3, "z": 1}[command.lower()]
        for piece in values.reshape(-1, size, 2) if command != "z" else [start[None, :]]:
            piece = piece + here if command in "lqc" else piece
            found += [tuple(point) for point in piece] if command != "z" else []
            here = piece[-1]
            start = here if command == "M" else start
    return np.array(found)


def test_a_path_by_differences_ends_where_it_did():
    """A thousand roundings do not add up."""
    points = np.cumsum(np.random.default_rng(1).normal(0, 0.3333, (1000, 2)), axis=0)
    path = "M " + " L ".join(f"{x:.6f} {y:.6f}" for x, y in points)
    short = shortened(path)
    assert np.abs(places(short) - points).max() <= 0.0051
    assert len(short) < 0.5 * len(path)


def test_gaps_closed_ends_and_curves_are_kept():
    path = "M 1.5 2 L 3 2 L 3 4 z M 10 10 C 11 10 12 11 12 12 L 13 12 z M 0 0 Q 1 1 2 0"
    assert shortened(path) == "M1.5 2l1.5 0 0 2zM10 10c1 0 2 1 2 2l1 0zM0 0q1 1 2 0"
    assert places(shortened(path)) == pytest.approx(places(path))


def test_marks_of_one_look_say_it_once_and_text_is_left_alone():
    mark = '<use href="#m1234567890" x="10.123456" y="2.000000" style="fill: #0b5fa5"/>\n'
    other = mark.replace("#0b5fa5", "#123456")
    text = f'<path id="m1234567890" d="M 0 0"/>{mark}{mark}{other}<text x="1.0">id="m1234567890" 1.23456</text>'
    use = '<use href="#0" x="10.12" y="2"/>\n'
    expected = f'<path id="0" d="M0 0"/><g style="fill: #0b5fa5">\n{use}{use}</g>\n'
    expected += '<use href="#0" x="10.12" y="2" style="fill: #123456"/>\n'
    assert lean(text) == expected + '<text x="1">id="m1234567890" 1.23456</text>'
