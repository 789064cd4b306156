"""Positioning and validation end to end: protocol file, plan, engine, run folder, reduction, on the simulated muscle."""

import pytest

from tests.test_characterisation import analysed

NO_CYCLES = ("prepare.precondition.cycles", "0")


def numbers(analysis, symbol, method, over):
    return {round(e.at[over], 6): e.value for e in analysis.estimates if (e.symbol, e.method) == (symbol, method)}


def test_validation_on_the_ideal_muscle_is_right_to_a_permille(tmp_path):
    """Row 11: below 0.10 % of the measured contraction, from 8 s to 10 s, at the four pressures of paper 0."""
    pressures = ("sweep.matrix.pressure", "[200 kPa, 300 kPa, 400 kPa, 500 kPa]")
    settings = [NO_CYCLES, pressures, ("model.coefficients", "paper0 ideal")]
    found = analysed(tmp_path, "validation", "mock-ideal", settings=settings)
    for method in ("commanded pressure", "measured pressure"):
        errors = numbers(found, "e_ss", method, "pressure")
        assert sorted(errors) == [2e5, 3e5, 4e5, 5e5]
        assert max(abs(error) for error in errors.values()) < 1e-3
    assert not [f.text for f in found.findings if f.level != "note"]


def test_without_friction_a_position_is_held_without_a_cycle_and_as_simulated(tmp_path):
    """Row 16: on the ideal muscle nothing hunts; the simulated loop is the run to a micrometre."""
    settings = [
        NO_CYCLES, ("sweep.matrix.setpoint", "[10 mm, 60 mm]"), ("trial.hold", "5 s"), ("trial.window", "[3 s, 5 s]"),
        ("model.coefficients", "paper0 ideal"), ("model.regulator", "null"), ("model.friction", "null"),
    ]  # fmt: skip
    found = analysed(tmp_path, "positioning-pi", "mock-ideal", settings=settings)
    assert max(abs(e) for e in numbers(found, "e_ss", "closed-loop", "setpoint").values()) < 1e-5
    assert not numbers(found, "x_pp", "closed-loop", "setpoint")
    assert max(numbers(found, "e_sim", "closed-loop, simulated", "setpoint").values()) < 1e-6
    assert any(f.text.startswith("no limit cycle at 10 mm, 60 mm") for f in found.findings)


def test_with_stiction_it_hunts_and_is_flagged(tmp_path):
    """Row 16 at 10 mm, gains of the true Ziegler-Nichols rule: about 0.33 mm peak to peak in 1.7 s."""
    settings = [
        NO_CYCLES,
        ("sweep.matrix.setpoint", "[10 mm]"),
        ("trial.hold", "12 s"),
        ("trial.window", "[4 s, 12 s]"),
    ]
    found = analysed(tmp_path, "positioning-pi", "mock", settings=settings)
    assert numbers(found, "x_pp", "closed-loop", "setpoint")[0.01] == pytest.approx(0.33e-3, rel=0.1)
    assert numbers(found, "T_c", "closed-loop", "setpoint")[0.01] == pytest.approx(1.7, rel=0.1)
    assert [f.text[:26] for f in found.findings if f.level == "doubt"] == ["stick-slip limit cycle at "]
