"""A map says what a file means; what is wrong in it is told at its place, all at once, with the nearest name."""

from pathlib import Path

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.errors import InvalidFile
from pmabench.files.document import read_document
from pmabench.store.importers.map_file import MapFile
from pmabench.store.importers.map_rules import factor_of, form_pattern
from tests.importing import read_map

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted([*(ROOT / "fixtures" / "maps").glob("*.yaml"), *(ROOT / "fixtures" / "old-runs").glob("*.yaml")])

GOOD = """\
schema: pmabench.map/1
name: a bench
source: nobody
kind: isometric
file: {delimiter: comma, header: none, names: [t, p, f]}
columns:
  t: {is: time, unit: ms}
  p: {is: pressure, unit: mA, points: [[4 mA, 0 bar], [20 mA, 12 bar]], range: [3.5 mA, 7 bar]}
  f: {is: force, unit: count, line: {slope: 0.5 N/count, offset: -10 N}}
sampling: {rate: [400 Hz, 700 Hz], gap: 50 ms}
trials: {by: file, point: {contraction: 4 mm}}
specimen: {type: muscle}
"""


def rules_of(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return read_map(path)


def problems_of(tmp_path, text):
    with pytest.raises(InvalidFile) as caught:
        rules_of(tmp_path, text)
    return [(p.line, p.column, p.message) for p in caught.value.problems]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_shipped_maps_are_good_and_satisfy_the_schema(path):
    rules = read_map(path)
    assert rules.column("pressure") is not None
    jsonschema.validate(read_document(path).data, MapFile.model_json_schema())


def test_every_shipped_map_names_its_source():
    for path in (ROOT / "fixtures" / "maps").glob("*.yaml"):
        assert "github" in read_map(path).file.source


def test_scales_come_out_in_si(tmp_path):
    rules = rules_of(tmp_path, GOOD)
    pressure, force = rules.column("pressure"), rules.column("force")
    assert pressure.slope * 4 + pressure.offset == pytest.approx(0, abs=1e-6)
    assert pressure.slope * 20 + pressure.offset == pytest.approx(12e5)
    assert pressure.low == pytest.approx(-0.375e5)
    assert pressure.high == pytest.approx(7e5)
    assert (force.slope, force.offset) == (0.5, -10.0)
    assert rules.column("time").slope == 1e-3
    assert rules.point == {"contraction": 0.004}


def test_a_wrong_calibration_is_turned_back():
    force = read_map(ROOT / "fixtures" / "maps" / "aarl-10mm.yaml").column("force")
    newtons = (100 * 1.6475 - 30.882) * 4.45
    count = (newtons - force.back[1]) / force.back[0]
    assert count == pytest.approx(100)
    assert count * force.slope + force.offset == pytest.approx((100 * 0.1535 - 1.963) * 4.45)


def test_contraction_is_positive_whatever_the_sensor_does():
    displacement = read_map(ROOT / "fixtures" / "maps" / "mit-2-151-step.yaml").column("displacement")
    assert displacement.slope * 18.82 + displacement.offset == pytest.approx(0, abs=1e-12)
    assert displacement.slope * 17.82 + displacement.offset == pytest.approx(0.1016 / 16)


@pytest.mark.parametrize(
    ("wrong", "right", "at", "message"),
    [
        ("is: pressure", "is: presure", "presure", '"presure" is not known here; did you mean "pressure"?'),
        ("unit: mA", "unit: V", "4 mA, 0 bar", "is a reading in V, not in mA"),
        ("12 bar", "12 N", "12 N", '"N" is no unit of pressure'),
        ("0.5 N/count", "0.5 N", "0.5 N", "is so much per count"),
        ("range: [3.5 mA", "ragne: [3.5 mA", "ragne", 'unknown key "ragne"; did you mean "range"?'),
        ("names: [t, p, f]", "names: [t, q, f]", "{is: pressure", 'no column is called "p"'),
        ("gap: 50 ms", "gap: 50", "50}", "50 needs a unit"),
        ("contraction: 4 mm", "contration: 4 mm", "4 mm", '"contration" is not known here'),
        (", line: {slope: 0.5 N/count, offset: -10 N}", "", "count}", '"count" is no unit of force'),
        ("[[4 mA, 0 bar]", "[[20 mA, 0 bar]", "[[20 mA", "need two different readings"),
    ],
)
def test_mistakes_are_reported_at_their_place(tmp_path, wrong, right, at, message):
    assert wrong in GOOD
    text = GOOD.replace(wrong, right)
    before = text[: text.index(at)]
    place = (before.count("\n") + 1, len(before) - before.rfind("\n"))
    found = problems_of(tmp_path, text)
    assert any(message in reported and (line, column) == place for line, column, reported in found), (place, found)


def test_all_mistakes_at_once(tmp_path):
    text = GOOD.replace("gap: 50 ms", "gap: 50").replace("kind: isometric", "kind: isometrik")
    assert len(problems_of(tmp_path, text)) == 2


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("header: none", "header: first line"),
        ("delimiter: comma", "delimiter: comma, decimal: comma"),
        ("t: {is: time, unit: ms}", "t: ignore"),
        ("f: {is: force", "f: {is: pressure"),
        ("by: file", "by: gap"),
        ("by: file", "by: step"),
        ("unit: count, line", "unit: count, points: [[1 count, 2 N], [2 count, 3 N]], line"),
        ("names: [t, p, f]", "names: [t, p, f, x]"),
    ],
)
def test_contradictions_are_refused(tmp_path, wrong, right):
    assert wrong in GOOD
    assert problems_of(tmp_path, GOOD.replace(wrong, right))


def test_points_off_a_straight_line_need_an_uncertainty_that_covers_them(tmp_path):
    bent = GOOD.replace("[20 mA, 12 bar]]", "[12 mA, 6.1 bar], [20 mA, 12 bar]]")
    assert any("bend away" in text for _, _, text in problems_of(tmp_path, bent))
    assert rules_of(tmp_path, bent.replace("range:", "expanded_uncertainty: 0.1 bar, range:"))


def test_rad_per_second_is_not_hertz():
    assert factor_of("rad/s", "frequency") * 2 * 3.141592653589793 == pytest.approx(1)
    assert factor_of("Hz", "frequency") == 1
    with pytest.raises(ValueError, match="may mean"):
        factor_of("1/s", "frequency")


def test_forms_of_names():
    match = form_pattern("10mm_13cm_Kinked{contraction}mm_Test{test}", False).fullmatch("10mm_13cm_Kinked4mm_Test10")
    assert match.groupdict() == {"contraction": "4", "test": "10"}
    match = form_pattern("*frq_test_rads-{frequency}_exp", True).fullmatch("x_frq_test_rads-1,57_exp")
    assert match.groupdict() == {"frequency": "1,57"}
    for bad in ("{contraction}{test}", "{velocity}", "*a*b*c", "{test}_{test}"):
        with pytest.raises(ValueError, match=r".+"):
            form_pattern(bad, False)


@pytest.mark.parametrize("wrong", ["dead: -1", "temperature: 20", "temperature_half: 50"])
def test_a_meter_of_flow_is_within_what_a_protocol_may_say(tmp_path, wrong):
    """20 is degrees Celsius in place of kelvin: the volume would be fifteen times too small."""
    meter = {"dead": "12e-6", "dead_half": "1e-7"} | dict([wrong.split(": ")])
    text = ", ".join(f"{name}: {value}" for name, value in meter.items())
    [(line, _, message)] = problems_of(tmp_path, f"{GOOD}settings: {{flow: {{{text}}}}}\n")
    assert (line, wrong.split(": ")[1] in message, "should be" in message) == (len(GOOD.splitlines()) + 1, True, True)


def test_a_factor_that_is_no_longer_read_is_no_key_of_a_meter(tmp_path):
    meter = "{dead: 12e-6, dead_half: 1e-7, gain: 1.05}"
    assert any("gain" in message for _, _, message in problems_of(tmp_path, f"{GOOD}settings: {{flow: {meter}}}\n"))


def test_a_form_cannot_hang():
    pattern = form_pattern("*a*b{test}", False)
    assert pattern.fullmatch("a" * 255) is None


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.data())
def test_mutated_maps_are_read_or_refused(tmp_path_factory, data):
    text = (ROOT / "fixtures" / "maps" / "aarl-10mm.yaml").read_text(encoding="utf-8")
    at = data.draw(st.integers(0, len(text) - 1))
    until = at + data.draw(st.integers(0, 12))
    new = data.draw(st.text(alphabet="{}[]:,-#&*!|>'\"%@ \n\t0123456789aeN.", max_size=6))
    path = tmp_path_factory.getbasetemp() / "mutated-map.yaml"
    path.write_text(text[:at] + new + text[until:], encoding="utf-8")
    try:
        read_map(path)
    except InvalidFile as refused:
        assert refused.problems


def test_the_map_in_the_documentation_is_good(tmp_path):
    text = (ROOT / "docs" / "maps.md").read_text(encoding="utf-8")
    example = text.split("```yaml\n")[1].split("```")[0]
    rules = rules_of(tmp_path, example)
    assert rules.file.analysis.force_above == 20.0
    fields = [
        *(field.alias or name for name, field in MapFile.model_fields.items()),
        *rules.file.file.model_fields_set,
        "late_by",
        "stale_after",
        "gain_uncertainty",
    ]
    reported = text.replace("`", " ")
    missing = [name for name in fields if name.rstrip("_") not in reported]
    assert not missing
