"""Quantities are NUMBER UNIT and nothing else; what other programs guess is refused."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmabench.files.quantity import (
    USUAL,
    library_factor,
    parse_mass_or_force,
    parse_plates,
    parse_quantity,
    unit_factor,
)


@pytest.mark.parametrize(
    ("text", "quantity", "si"),
    [
        ("300 kPa", "pressure", 300e3),
        ("3 bar", "pressure", 3e5),
        ("100 psi", "pressure", 689475.7293168361),
        ("10 mm", "length", 0.01),
        ("2 um", "length", 2e-6),
        ("2 µm", "length", 2e-6),
        ("2 kPa/s", "pressure rate", 2000.0),
        ("9.81 m/s2", "acceleration", 9.81),
        ("1.5 N.s/mm", "damping", 1500.0),
        ("7 N/mm", "stiffness", 7000.0),
        ("7.1 bar/cm", "gain", 7.1e7),
        ("25 %", "ratio", 0.25),
        ("500 Hz", "frequency", 500.0),
        ("1e2 kPa", "pressure", 1e5),
        ("-3 mm", "length", -0.003),
        ("60 rpm", "frequency", 1.0),
        ("6.283185307179586 rad/s", "frequency", 1.0),
    ],
)
def test_units_that_people_write(text, quantity, si):
    assert parse_quantity(text, quantity) == pytest.approx(si, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "quantity", "says"),
    [
        (500, "frequency", 'needs a unit, for instance "500 Hz"'),
        ("1,5 bar", "pressure", "decimal comma"),
        ("1 bar(g)", "pressure", "gauge or absolute"),
        ("nan", "pressure", "no pressure with a unit"),
        (float("nan"), "pressure", "needs a unit"),
        ("inf kPa", "pressure", "no pressure with a unit"),
        ("9**9**9 mm", "length", "no length with a unit"),
        ("1 s**9**9**9**9", "time", "unknown unit"),
        (10**400, "time", "needs a unit"),
        ("3 mm", "pressure", '"mm" is no unit of pressure'),
        ("3 kpa", "pressure", 'unknown unit "kpa"; did you mean "kPa"'),
        ("3 NM", "torque", 'unknown unit "NM"'),
        ("25 %", "pressure", "only where a ratio"),
        (True, "pressure", "with its unit"),
        (None, "pressure", "with its unit"),
        ("1e999 kPa", "pressure", "out of all range"),
    ],
)
def test_what_is_refused_and_how(text, quantity, says):
    with pytest.raises(ValueError, match=says.replace("(", r"\(").replace("*", r"\*")):
        parse_quantity(text, quantity)


def test_loads_are_masses_or_forces():
    assert parse_mass_or_force("6 kg") == ("mass", 6.0)
    assert parse_mass_or_force("58.86 N") == ("force", 58.86)
    with pytest.raises(ValueError, match="neither a mass nor a force"):
        parse_mass_or_force("3 kPa")
    assert parse_plates("5 x 2.5 kg") == (5, 2.5)
    for mass in ("-5 kg", "0 kg"):  # one of -5 kg made loads that nobody can hang
        with pytest.raises(ValueError, match="weighs more than nothing"):
            parse_plates(f"10 x {mass}")


@given(st.text(max_size=40))
def test_no_text_does_anything_but_parse_or_refuse(text):
    try:
        value = parse_quantity(text, "pressure")
    except ValueError:
        return
    assert abs(value) < float("inf")


@pytest.mark.parametrize(("quantity", "unit"), [(quantity, unit) for quantity, of in USUAL.items() for unit in of])
def test_the_usual_units_are_those_of_the_units_library(quantity, unit):
    assert USUAL[quantity][unit] == library_factor(unit, quantity) == unit_factor(unit, quantity)


def test_the_shipped_bench_is_read_without_the_units_library():
    """It takes a quarter of a second to be loaded, in every process."""
    code = (
        "import sys; from pmabench.bench.compile import mount_alone; from pmabench.files.shipped import shipped_folder"
    )
    code += "; mount_alone(shipped_folder('bench') / 'wires.yaml'); print('pint' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
