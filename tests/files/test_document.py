"""YAML files: every problem at once, each at its place; hostile files are refused in a sentence."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import Field

from pmabench.base.errors import InvalidFile
from pmabench.files.document import Document, Strict, read_document, validate
from pmabench.files.quantity import Frequency, Length, Pressure


class Inner(Strict):
    rate: Frequency
    pressure: Pressure = 0.0
    lengths: list[Length] = []


class Outer(Strict):
    name: str
    inner: Inner
    many: dict[str, Inner] = {}


def problems(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "file.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFile) as caught:
        validate(Outer, read_document(path))
    return [f"{p.line}:{p.column} {p.message}" for p in caught.value.problems]


def test_every_problem_at_once_with_place_and_nearest_name(tmp_path):
    text = """name: x
inner:
  rate: 500
  presure: 3 kPa
  lengths: [1 mm, 2 kPa]
many:
  a: {rate: on}
  b: 12:30
"""
    assert problems(tmp_path, text) == [
        '3:9 500 needs a unit, for instance "500 Hz"',
        '4:3 unknown key "presure"; did you mean "pressure"?',
        '5:19 "kPa" is no unit of length, for instance "10 mm"',
        '7:13 "on" is no frequency with a unit, for instance "500 Hz"',
        '8:6 "b" needs its own keys and values, not "12:30"',
    ]


def test_a_decimal_comma_in_braces_is_called_that(tmp_path):
    """`{pressure: 10,5 kPa}` is a pressure of 10, and a key "5 kPa"."""
    found = problems(tmp_path, "name: x\ninner: {rate: 500 Hz, pressure: 10,5 kPa}\n")
    assert '2:36 "5 kPa" begins a key of its own: write a number with a point, 10.5, not with a comma' in found


def test_a_missing_key_is_named_at_its_parent(tmp_path):
    assert problems(tmp_path, "name: x\ninner:\n  pressure: 1 kPa\n") == ['3:3 "rate" is missing']


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name: x\nname: y\n", "is given twice"),
        ("- 1\n", "keys and values"),
        ("name: !!python/object/apply:os.system [x]\n", "tags are not allowed"),
        ("name: [\n", "not readable as YAML"),
        ("a: &a [1]\nb: &b [*a,*a]\n" + "c: [" + "*b," * 60000 + "]", "too large"),
        ("a: " + "[" * 60 + "]" * 60, "too deep"),
        ("", "is empty"),
        ("<<: {a: 1}\n", "plain name"),
    ],
)
def test_hostile_files_are_refused_in_a_sentence(tmp_path, text, says):
    path = tmp_path / "bad.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFile, match=says):
        read_document(path)


def test_binary_and_absent_files(tmp_path):
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InvalidFile, match="not text in UTF-8"):
        read_document(tmp_path / "b.yaml")
    with pytest.raises(InvalidFile, match="cannot be read"):
        read_document(tmp_path / "absent.yaml")
    with pytest.raises(InvalidFile, match="is a folder; a YAML file is expected"):
        read_document(tmp_path)


def test_yaml_1_2_words_and_times_stay_text():
    document = Document("f", "a: on\nb: 12:30\nc: no\nd: true\ne: 0x10\nf: 1_000\n")
    assert document.data == {"a": "on", "b": "12:30", "c": "no", "d": True, "e": "0x10", "f": "1_000"}


def test_include_overlays_and_keeps_both_places(tmp_path):
    (tmp_path / "base.yaml").write_text("name: base\ninner: {rate: 5 Hz, pressure: 1 kPa}\n")
    (tmp_path / "top.yaml").write_text("include: base.yaml\n\ninner: {pressure: 2 kPa}\n")
    document = read_document(tmp_path / "top.yaml")
    model = validate(Outer, document)
    assert model.name == "base"
    assert model.inner.rate == 5.0
    assert model.inner.pressure == 2000.0
    assert document.place(("inner", "pressure"))[1:] == (3, 19)
    assert document.where(("inner", "rate")).endswith("base.yaml:2:15")


def test_include_never_leaves_relative_paths_and_never_loops(tmp_path):
    (tmp_path / "a.yaml").write_text("include: a.yaml\n")
    with pytest.raises(InvalidFile, match="at most three deep"):
        read_document(tmp_path / "a.yaml")
    (tmp_path / "b.yaml").write_text("include: /etc/passwd\n")
    with pytest.raises(InvalidFile, match="relative path"):
        read_document(tmp_path / "b.yaml")


def test_override_names_its_place(tmp_path):
    (tmp_path / "f.yaml").write_text("name: x\ninner: {rate: 5 Hz, lengths: [1 mm, 2 mm]}\n")
    document = read_document(tmp_path / "f.yaml")
    document.override("inner.lengths.1", "7 mm")
    document.override("inner.rate", "3 kPa")
    with pytest.raises(InvalidFile) as caught:
        validate(Outer, document)
    assert str(caught.value.problems[0]).startswith("--set inner.rate:1:8")
    with pytest.raises(InvalidFile, match='did you mean "inner"'):
        document.override("iner.rate", "3 Hz")


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.text(max_size=300))
def test_any_text_gives_a_model_or_an_invalid_file(text):
    try:
        validate(Outer, Document("f", text))
    except InvalidFile as error:
        assert error.problems


def test_folded_text_is_one_line_without_marks():
    assert Document("f", "a: >-\n  one;\n  two\n").data == {"a": "one; two"}


class Typed(Strict):
    schema_: Annotated[Literal["pmabench.typed/1"], Field(alias="schema")]
    count: int = 1
    share: float = 0.0
    on: bool = False
    lengths: list[Length] = []
    name: str
    other: str


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("count: two", '"two" is not a whole number'),
        ("count: 1.5", '"1.5" is not a whole number'),
        ("share: much", '"much" is not a number'),
        ("on: perhaps", '"perhaps" is not true or false'),
        ("name: 5", '"5" is not a text (in quotes)'),
        ("lengths: 7 mm", '"lengths" needs a list, for instance [7 mm]'),
        ("a: b: c", "is the line indented further than the one above?"),
        ("name: x\n\tcount: 3", "a tab; YAML is indented with spaces"),
        ("name: @x", "a value that begins with this sign needs quotes"),
        ("lengths: [7 mm, 8 mm", "lacks a comma or its closing bracket"),
        ('name: "x', "a quote is not closed"),
    ],
)
def test_mistakes_are_said_in_the_words_of_a_writer_of_files(text, says):
    with pytest.raises(InvalidFile) as caught:
        validate(Typed, Document("f", f"schema: pmabench.typed/1\n{text}\n"))
    assert says in str(caught.value)


def test_a_file_that_does_not_say_what_it_is_is_asked_that_first():
    with pytest.raises(InvalidFile) as caught:
        validate(Typed, Document("f", "cuont: 3\n"))
    first, second = (problem.message for problem in caught.value.problems)
    assert first == '"schema" is missing, which says what kind of file it is: "schema: pmabench.typed/1"'
    assert second == 'unknown key "cuont"; did you mean "count"?', (
        "other mistakes are reported, but for what is missing"
    )
