"""Sweeps are expanded statically, in the order that is written, and bounded before they are built."""

import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.cli.main import main
from pmabench.files.document import Document, Strict, validate
from pmabench.kinds.contraction_relaxation.protocol import ContractionAxes
from pmabench.protocol.sweep import Sweep, expand


class Holder(Strict):
    sweep: Sweep[ContractionAxes]


def points(text: str) -> list[tuple[float, float, int]]:
    document = Document("p.yaml", text)
    found = expand(validate(Holder, document).sweep, document)
    return [(p.values["load"][1], p.values["pressure"] / 1e3, p.repeat) for p in found]


MATRIX = "matrix: {load: [6 kg, 11 kg], pressure: {start: 100 kPa, stop: 200 kPa, step: 50 kPa}}"


def test_matrix_runs_the_first_axis_outermost():
    assert points(f"sweep: {{{MATRIX}}}") == [
        (6, 100, 0),
        (6, 150, 0),
        (6, 200, 0),
        (11, 100, 0),
        (11, 150, 0),
        (11, 200, 0),
    ]


def test_snake_turns_at_each_row_and_at_each_block():
    found = points(f"sweep: {{{MATRIX}, order: snake, repeat: {{count: 2}}}}")
    assert [p[:2] for p in found[:6]] == [(6, 100), (6, 150), (6, 200), (11, 200), (11, 150), (11, 100)]
    assert found[6][:2] == (11, 100)
    assert {p[2] for p in found[6:]} == {1}


def test_adjacent_repeats_one_point_at_once():
    found = points(f"sweep: {{{MATRIX}, repeat: {{count: 3, as: adjacent}}}}")
    assert found[:4] == [(6, 100, 0), (6, 100, 1), (6, 100, 2), (6, 150, 0)]


def test_random_is_the_same_each_time_and_complete():
    text = f"sweep: {{{MATRIX}, order: random, seed: 3}}"
    assert points(text) == points(text)
    assert sorted(points(text)) == sorted(points(f"sweep: {{{MATRIX}}}"))
    assert points(text) != points(f"sweep: {{{MATRIX}}}")


def test_zip_and_concat():
    assert points("sweep: {zip: {load: [6 kg, 7 kg], pressure: [100 kPa, 200 kPa]}}") == [(6, 100, 0), (7, 200, 0)]
    both = "sweep: {concat: [{zip: {load: [6 kg], pressure: [100 kPa]}}, {matrix: {load: [7 kg], pressure: [1 bar, 2 bar]}}]}"
    assert points(both) == [(6, 100, 0), (7, 100, 0), (7, 200, 0)]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sweep: {zip: {load: [6 kg], pressure: [1 bar, 2 bar]}}", "unlike length"),
        (
            "sweep: {matrix: {load: [6 kg], pressure: {start: 0 kPa, stop: 1000 kPa, step: 0.000001 kPa}}}",
            "at most 20000",
        ),
        ("sweep: {matrix: {load: [6 kg], pressure: {start: 0 kPa, stop: 100 kPa, step: 30 kPa}}}", "whole steps"),
        ("sweep: {matrix: {load: [6 kg], pressure: {start: 0 kPa, stop: 100 kPa, step: 0 kPa}}}", "above zero"),
        (f"sweep: {{{MATRIX}, repeat: {{count: 1000000000}}}}", "less than or equal to 1000"),
        (
            "sweep: {matrix: {load: [6 kg], pressure: {start: 0 kPa, stop: 10 kPa, step: 1 Pa}}, repeat: {count: 1000}}",
            "10001000 trials",
        ),
        (
            "sweep: {concat: ["
            + ("{matrix: {load: [6 kg], pressure: {start: 0 kPa, stop: 15 kPa, step: 1 Pa}}}," * 2)
            + "]}",
            "more than 20000",
        ),
        ("sweep: {}", "exactly one of"),
        ("sweep: {matrix: {load: [], pressure: [1 bar]}}", "at least 1 item"),
    ],
)
def test_sweeps_that_cannot_be_run(text, says):
    with pytest.raises(InvalidFile, match=says):
        points(text)


def checked(*settings):
    words = [part for setting in settings for part in ("--set", setting)]
    bench = ["--bench", "mock", "--specimen", "mas-20-250-paper0", "-q"]
    return CliRunner().invoke(main, ["check", "contraction-relaxation", *bench, *words])


def test_a_range_in_the_wrong_unit_is_a_line_for_each_limit_not_for_each_value():
    """2 bar to 400 bar where 400 kPa was meant: 797 values, of which nine lie inside the limit of 600 kPa."""
    reported = checked("sweep.matrix.pressure={start: 2 bar, stop: 400 bar, step: 50 kPa}")
    assert reported.exit_code == 3
    assert "788 values, 650 kPa to 40000 kPa, are above the limit for commanded pressure, 600 kPa" in reported.output
    assert len(reported.output.splitlines()) < 8, reported.output
