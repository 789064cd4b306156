"""Whatever stands in a bench or specimen file: it compiles, or every problem has a sentence and a place; no traceback."""

import copy
import json
from math import isfinite

from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from tests.bench.benches import RIG, SPECIMEN, rig

NASTY = st.sampled_from(
    [
        None, True, 0, -1, 1e308, "", " ", "~", "0", "-5 kPa", "1e300 MPa", "1e308 GPa", "300 mm", "5 %", "-5 %", "1 x 5 kg",
        "nan kPa", "pressure", "displacement", "dump_valve", "daq", "none", "0 count", "65535 count", "0 kPa", "0 s", "1 h",
        "../calibrations/MOCK-P", "MOCK-P", "2026-11-20", [], [[]], {}, {"set": "pressure"}, ["0 V", "1 V"],
        [["0 V", "0 kPa"], ["0 V", "0 kPa"]], "x" * 500, "\u0000", "[/]", "${HOME}",
    ]
)  # fmt: skip


def places(data, at=()):
    """Every location in plain data."""
    if at:
        yield at
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*at, key))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from places(value, (*at, index))


DATA = YAML(typ="safe", pure=True).load(RIG)
MUSCLE = YAML(typ="safe", pure=True).load(SPECIMEN.read_text())


def changed(data, at, value, *, delete):
    made = copy.deepcopy(data)
    target = made
    for part in at[:-1]:
        target = target[part]
    if delete:
        del target[at[-1]]
    else:
        target[at[-1]] = value
    return made


def text_of(data) -> str:
    return json.dumps(data, default=str)  # JSON is YAML


@settings(max_examples=150)
@given(st.data())
def test_a_hostile_bench_compiles_or_has_sentences(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "hostile"
    folder.mkdir(exist_ok=True)
    path = rig(folder)
    bench, muscle = DATA, MUSCLE
    for _ in range(data.draw(st.integers(1, 3))):
        specimen = data.draw(st.integers(0, 5)) == 0
        whole = muscle if specimen else bench
        at = data.draw(st.sampled_from(list(places(whole))))
        made = changed(whole, at, data.draw(NASTY), delete=data.draw(st.booleans()))
        bench, muscle = (bench, made) if specimen else (made, muscle)
    path.write_text(text_of(bench))
    (folder / "muscle.yaml").write_text(text_of(muscle))
    try:
        compiled = mount(path, folder / "muscle.yaml").bench
    except InvalidFile as error:
        assert error.problems
        assert all(problem.line > 0 and problem.message for problem in error.problems), error
        return
    for output in compiled.outputs:
        assert isfinite(output.low)
        assert output.low <= output.safe <= output.high <= 600e3
    trips = [trip for trip in compiled.trips if trip.channel == "pressure" and trip.kind == "range"]
    assert any(trip.high is not None and trip.high < 700e3 and trip.action == "vent" for trip in trips)
    assert [action for action in compiled.safe_state if action.do == "set" and action.target == "pressure"][
        -1
    ].value == 0
    assert any(action.do == "confirm" for action in compiled.safe_state)
