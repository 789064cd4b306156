"""The law of a position loop: what it commands, when it ends, what it writes down."""

from __future__ import annotations

import json
from math import nan
from typing import Any

import pytest

from pmabench.engine.laws.position_loop import PositionLoop
from tests.analysis.loop_rig import LinearPlant
from tests.engine.loop_cost import MOST, plain_calls


def law(**change: Any) -> PositionLoop:
    given = {"setpoint": 1e-3, "duration": 4.0, "K_p": 1e7, "T_i": 0.3, "low": 0.0, "high": 1e5, **change}
    return PositionLoop(**given)


def run(loop: PositionLoop, plant: LinearPlant) -> list[tuple[float, float]]:
    rows = []
    for k in range(10_000):
        if loop.done:
            break
        command = loop.update(5.0 + 0.002 * k, plant.read())
        rows.append((plant.state[-1] * plant.gain, command))
        plant.step(command)
    return rows


def plant() -> LinearPlant:
    return LinearPlant(1.5e-7, 0.04, (0.0955, 0.25), noise=(0.0, 0.0))


def test_pi_takes_a_linear_plant_to_the_set_point_and_ends_in_time():
    loop = law()
    rows = run(loop, plant())
    found = loop.result()
    assert rows[-1][0] == pytest.approx(1e-3, rel=1e-3)
    assert found["ended"] == "time"
    assert "found" not in found
    assert found["t1"] - found["t0"] == pytest.approx(4.0, abs=2.1e-3)
    assert found["command"] == pytest.approx(1e-3 / 1.5e-7, rel=1e-3)
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_p_alone_leaves_the_error_that_it_must():
    """e / r = 1 / (1 + K_p k_g)."""
    loop = law(T_i=None)
    rows = run(loop, plant())
    assert 1e-3 - rows[-1][0] == pytest.approx(1e-3 / (1 + 1e7 * 1.5e-7), rel=1e-3)


def test_it_stays_inside_its_range_and_shows_how_long_it_was_at_the_end():
    loop = law(setpoint=1.0)
    assert {command for _, command in run(loop, plant())} == {1e5}
    assert loop.result()["saturated"] == 1.0


@pytest.mark.parametrize("values", [{}, {"displacement": nan}, {"displacement": float("inf")}])
def test_without_a_signal_it_ends_and_holds_its_last_command(values):
    loop = law()
    last = loop.update(0.0, {"displacement": 0.5e-3})
    assert loop.update(0.002, values) == last
    assert loop.done
    assert loop.update(0.004, {"displacement": 0.0}) == last
    found = loop.result()
    assert not found["found"]
    assert found["reason"] == "displacement gave no number"


def test_what_cannot_be_is_refused():
    for wrong, reported in (({"duration": 0.0}, "duration"), ({"setpoint": nan}, "set-point"), ({"K_p": -1.0}, "K_p")):
        with pytest.raises(ValueError, match=reported):
            law(**wrong)


def test_an_update_costs_few_plain_calls():
    assert plain_calls(law(duration=1e9, T_d=0.02)) < MOST
