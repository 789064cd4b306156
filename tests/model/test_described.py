"""A muscle with its regulator as plain numbers: nothing is lost on the way through a plan's JSON."""

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest

from pmabench.bench.plant import read_plant
from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import KINDS, MUSCLES, Described, changed, preset, setup_of
from pmabench.model.regulator import constant

FILES = sorted((Path(__file__).parents[2] / "fixtures" / "plants").glob("*.yaml"))


def through_json(setup, **changes):
    muscle = replace(setup.muscle, **changes)
    reported = Described(muscle, setup.regulator, "where it is from", (1e5, 5e5), setup.air)
    assert Described.of(json.loads(json.dumps(reported.to_dict()))) == reported


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", MUSCLES)
def test_every_field_of_a_preset_comes_back(name, kind):
    through_json(preset(name, kind))


def test_every_field_of_the_shipped_plant_files_comes_back():
    """Of those that are three-element muscles; a plan takes no other as a model."""
    setups = [changed(setup_of(read_plant(path).numbers), "bench") for path in FILES]
    models = [setup for setup in setups if isinstance(setup.muscle, Muscle)]
    assert len(models) >= 3
    assert any(setup.air for setup in models)
    for setup in models:
        through_json(setup)


def test_a_muscle_of_which_no_field_is_as_it_is_by_itself_comes_back():
    """A field that is added to a muscle and not told would be lost in silence."""
    setup = preset("paper0", "bench")
    odd = {"name": "M", "friction": Friction(3.0, 2.0, 4e-3), "tau_r": Curve(((1e-7, 0.1), (0.2,)), (2e5,))}
    for field in fields(Muscle):
        if field.name not in {*odd, "F_ce", "K", "B_c", "B_r"}:
            odd[field.name] = 0.123
    through_json(setup, **odd)


def test_a_plan_of_an_earlier_version_is_still_read():
    """It told neither a name nor what muscles have had since."""
    setup = preset("paper0", "bench")
    reported = Described(setup.muscle, setup.regulator, "preset paper0", (0.0, 1e7)).to_dict()
    for name in ("name", "tau_r", "diameter", "braid_angle"):
        reported.pop(name, None)
    assert Described.of(reported).muscle == replace(setup.muscle, name="preset paper0")


def test_its_plant_is_that_of_the_setup_with_the_air_too():
    """A step to 300 kPa: the air of `paper0-air` holds the contraction back by more than a millimetre."""
    x = {}
    for name in ("paper0", "paper0-air"):
        setup = preset(name, "bench")
        reported = Described(setup.muscle, setup.regulator, name, (0.0, 1e7), setup.air)
        plants = Described.of(reported.to_dict()).plant(20.0, 2.0), setup.free(20.0, 2.0)
        x[name] = []
        for plant in plants:
            plant.command(constant(0.0, 3e5))
            plant.advance(0.4)
            x[name].append(plant.x)
        assert x[name][0] == x[name][1]
    assert abs(x["paper0"][0] - x["paper0-air"][0]) > 1e-3
