"""`init`: questions and answer files give the same lab, which passes `check --simulate`; guesses stop a real bench."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from pmabench.bench.compile import mount
from pmabench.bench.lab.questions import MOST, QUESTIONS
from pmabench.cli.main import main

FILES = ("protocol.yaml", "--bench", "bench.yaml", "--specimen", "specimen.yaml")
MUSCLE = {
    "make": "Festo",
    "type": "DMSP-20-250N",
    "never_above": "700 kPa",
    "supply": "800 kPa, relief 680 kPa",
}
LABJACK = MUSCLE | {"daq": "labjack", "dump_valve": "FIO0 closed"}
OWN = {
    "make": "our lab",
    "type": "braid 3",
    "serial": "B3",
    "nominal_length": "180 mm",
    "inner_diameter": "12 mm",
    "never_above": "400 kPa",
    "supply": "500 kPa, relief 390 kPa",
    "stack": "hanger 0.5 kg, plates 10 x 1 kg + 1 x 0.5 kg",
    "daq": "ni",
    "dump_valve": "port1/line0 open",
}
MAP = Path(__file__).resolve().parents[2] / "fixtures" / "benches" / "registers" / "pressure-regulator.yaml"
LABS = {
    "simulated": MUSCLE,
    "simulated with an actuator": MUSCLE | {"free_end": "actuator", "type": "MAS-40-300N"},
    "labjack": LABJACK,
    "labjack with an actuator": LABJACK | {"free_end": "actuator"},
    "ni": OWN,
    "board": MUSCLE | {"daq": "board", "dump_valve": "v0 closed", "interlock": "d0", "protocol": "static-load"},
    "no dump valve": LABJACK | {"dump_valve": "none", "supply": "800 kPa, relief none"},
    "small": OWN | {"never_above": "150 kPa", "supply": "200 kPa, relief none", "daq": "none"},
}


def call(*arguments: str, code: int = 0, typed: str | None = None) -> str:
    result = CliRunner().invoke(main, [str(word) for word in arguments], input=typed, catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def answered(folder: Path, answers: dict[str, str], code: int = 0) -> str:
    words = [word for key, value in answers.items() for word in ("--answer", f"{key}={value}")]
    return call("init", str(folder), *words, code=code)


def contents(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("lab", LABS)
def test_a_lab_passes_check_and_holds_no_value_of_the_shipped_muscle(
    lab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = LABS[lab]
    answered(tmp_path / "by-options", answers)
    monkeypatch.chdir(tmp_path / "by-options")
    reported = json.loads(
        call("check", *FILES, "--json", code=0 if "daq" not in answers or answers["daq"] == "none" else 3)
    )
    assert reported["trials"] >= 4
    assert reported["unconfirmed"]
    text = "".join(text for name, text in contents(Path()).items() if not name.startswith("schemas"))
    for word in ("MOCK", "paper0", "55.6 kg", "??"):
        assert word not in text, word


def test_an_actuator_is_watched_to_both_sides(tmp_path: Path) -> None:
    answered(tmp_path / "lab", LABJACK | {"free_end": "actuator"})
    mounted = mount(tmp_path / "lab" / "bench.yaml", tmp_path / "lab" / "specimen.yaml")
    assert not [line for line in mounted.lacks if "drive" in line], mounted.lacks
    trips = {(trip.channel, trip.kind): trip for trip in mounted.bench.trips}
    assert trips["displacement", "following"].action == "vent"
    assert trips["displacement", "range"].low < mounted.bench.commanded["displacement"].low


def test_typed_answers_and_an_answers_file_write_the_same_files(tmp_path: Path) -> None:
    """Enter takes what is proposed, and - too: nobody has said it then, and it is to be confirmed."""
    lines = {
        **{"make": "Festo", "type": "DMSP-20-250N", "serial": "?\nA017", "never_above": "\n-\n700\n700 kPa"},
        **{"mounted": "-", "supply": "800 kPa, relief 900 kPa\n800 kPa, relief 680 kPa", "daq": "1"},
        **{"dump_valve": "FIO0\nFIO0 closed", "contraction": "b\n700 kPa\n-"},
    }
    order = [key for key in QUESTIONS if key != "actuator"]
    out = call("init", str(tmp_path / "typed"), typed="\n".join(lines.get(key, "") for key in order) + "\n")
    assert len(order) == MOST == out.count(f" of at most {MOST}  ") - 2  # b: two questions are asked again
    kept = tmp_path / "typed" / "answers.yaml"
    given = YAML(typ="safe").load(kept.read_text())
    assert given["serial"] == "A017"
    assert given["mounted"] is None
    assert given["inner_diameter"] is None
    assert given["contraction"] is None
    assert given["sensors"] is None
    bench = YAML(typ="safe").load((tmp_path / "typed" / "bench.yaml").read_text())
    assert {"channels.pressure.range", "outputs.pressure.scale", "channels.force.input"} <= set(bench["to_confirm"])
    specimen = YAML(typ="safe").load((tmp_path / "typed" / "specimen.yaml").read_text())
    count = len(bench["to_confirm"]) + len(specimen["to_confirm"])
    assert f"{count} values are marked TO CONFIRM" in " ".join(out.split())
    assert given["daq"] == "labjack"
    assert given["never_above"] == "700 kPa"
    call("init", str(tmp_path / "again"), "--answers", str(kept))
    assert contents(tmp_path / "typed") == contents(tmp_path / "again")
    words = [word for key, value in given.items() if key != "asked" for word in ("--answer", f"{key}={value or ''}")]
    call("init", str(tmp_path / "options"), *words)
    assert contents(tmp_path / "options") == contents(tmp_path / "again")


def test_the_proposed_protocol_moves_the_muscle(tmp_path: Path) -> None:
    """Of a thin muscle and few heavy plates: lighter loads would allow no pressure that lifts the others."""
    answered(
        tmp_path / "lab",
        {
            **{"make": "Festo", "type": "DMSP-10-200", "nominal_length": "200 mm", "inner_diameter": "10 mm"},
            **{"never_above": "8 bar", "contraction": "25 %", "stack": "hanger 1 kg, plates 4 x 5 kg, pulley"},
            "supply": "700 kPa, relief none",
        },
    )
    files = [name if name.startswith("--") else str(tmp_path / "lab" / name) for name in FILES]
    said = call("check", *files)
    idle = re.search(r"(\d+) of (\d+) trials are not expected to lift", said)
    assert idle is None or int(idle[1]) < 0.25 * int(idle[2]), said


def test_an_interrupted_init_goes_on_where_it_was(tmp_path: Path) -> None:
    folder = tmp_path / "lab"
    out = call("init", str(folder), typed="Festo\nDMSP-20-250N\nA017\n", code=2)
    assert "no answer to nominal_length" in out
    assert [path.name for path in folder.iterdir()] == ["answers.yaml"]
    rest = "\n\n700 kPa\n\n\n\n\n\n800 kPa, relief 680 kPa\n\n"
    assert "next    cd " in call("init", str(folder), typed=rest)
    assert 'serial: "A017"' in (folder / "specimen.yaml").read_text()


@pytest.mark.parametrize("key", ["never_above", "supply", "dump_valve"])
def test_what_protects_the_muscle_is_never_derived(key: str, tmp_path: Path) -> None:
    reported = answered(tmp_path / "lab", {name: value for name, value in LABJACK.items() if name != key}, code=2)
    assert f"--answer {key}=..." in reported
    assert not (tmp_path / "lab").exists()


@pytest.mark.parametrize(
    ("answer", "reported"),
    [
        ("supply=800 kPa, relief 700 kPa", "must open below the muscle's 700 kPa"),
        ("inner_diameter=20", "is no length with a unit"),
        ("dump_valve=FIO0", '"FIO0 closed", or "none"'),
        ("daqs=ni", 'did you mean "daq"'),
        ("sensors=pressure 0 V..10 V = 0 kPa..1 MPa", "displacement is missing"),
        ("inputs=pressure AIN0, displacement AIN1, force AIN2, command AIN3, actuator AIN4", "too many"),
    ],
)
def test_an_answer_that_cannot_be_is_refused_with_what_was_expected(answer: str, reported: str, tmp_path: Path) -> None:
    words = [word for key, value in LABJACK.items() for word in ("--answer", f"{key}={value}")]
    assert reported in call("init", str(tmp_path / "lab"), *words, "--answer", answer, code=2)
    assert not (tmp_path / "lab").exists()


def test_every_unconfirmed_value_is_refused_on_a_real_bench_and_none_on_a_simulated_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of 20 or more keys, left alone in the list, stops `run` before any device is opened."""
    answered(tmp_path / "lab", LABJACK)
    monkeypatch.chdir(tmp_path / "lab")
    texts = {name: Path(name).read_text() for name in ("bench.yaml", "specimen.yaml")}
    places = {name: YAML(typ="safe").load(text)["to_confirm"] for name, text in texts.items()}
    assert sum(map(len, places.values())) >= 20
    reviewed = "reviewed: {by: A. Reader, date: 2026-11-23}\n"
    cleared = {name: text[: text.index("to_confirm:")] + "to_confirm: []\n" for name, text in texts.items()}
    cleared["bench.yaml"] += reviewed
    for name, text in cleared.items():
        Path(name).write_text(text)
    call("check", *FILES)
    for name, keys in places.items():
        for key in keys:
            Path(name).write_text(cleared[name].replace("to_confirm: []", f"to_confirm: [{key}]"))
            reported = call("run", *FILES, "--yes", code=3)
            assert f'nobody has confirmed "{key}"' in reported
        Path(name).write_text(cleared[name])
    Path("bench.yaml").write_text(cleared["bench.yaml"].replace(reviewed, ""))
    assert "who read them over" in call("run", *FILES, "--yes", code=3)
    Path("bench.yaml").write_text(cleared["bench.yaml"].replace("to_confirm: []", "to_confirm: [limits.presure]"))
    assert 'did you mean "pressure"' in call("check", *FILES, code=3)
    assert not list(Path("runs").glob("*"))


def test_a_lab_without_devices_runs_to_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answered(tmp_path / "lab", MUSCLE)
    monkeypatch.chdir(tmp_path / "lab")
    short = ("--set", "sweep.repeat.count=1")
    assert "SIMULATED  FINISHED" in call("run", *FILES, "--yes", *short)


def test_no_limit_is_set_that_nobody_asked_for_and_the_file_shows_how(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answered(tmp_path / "lab", MUSCLE)
    monkeypatch.chdir(tmp_path / "lab")
    text = Path("protocol.yaml").read_text()
    assert "accept" not in YAML(typ="safe").load(text)
    before, lines = text.split("# accept:\n")
    Path("protocol.yaml").write_text(f"{before}accept:\n{lines.replace('#   K', '  K')}")
    assert YAML(typ="safe").load(Path("protocol.yaml"))["accept"] == {"K": {"relative_interval": "5 %"}}
    call("check", *FILES)


def test_a_register_map_is_copied(tmp_path: Path) -> None:
    answers = MUSCLE | {"daq": "modbus", "address": f"192.168.0.10, {MAP}", "dump_valve": "dump_valve closed"}
    reported = answered(tmp_path / "lab", answers, code=3)  # the shipped map is of a regulator: it measures no force
    assert "no input" in reported or "force" in reported


def test_a_shipped_bench_is_copied_with_like(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    call("init", str(tmp_path / "mock"), "--like", "mock-linear")
    call("init", str(tmp_path / "wires"), "--like", "wires")
    monkeypatch.chdir(tmp_path / "mock")
    assert "nothing was sent to a bench" in call("check", *FILES)
    monkeypatch.chdir(tmp_path / "wires")
    texts = "".join(path.read_text() for path in Path().rglob("*.yaml"))
    for word in ("simulated plant", "MOCK-P0", "F_ce:", "simulated muscle"):
        assert word not in texts, word
    assert call("check", *FILES, code=3).count("not filled in yet (??)") == 11 + 3 * 4
    assert 'did you mean "mock"' in call("init", str(tmp_path / "new"), "--like", "mok", code=3)
    assert not (tmp_path / "new").exists()


def test_editors_find_the_schemas_in_the_folder(tmp_path: Path) -> None:
    answered(tmp_path / "lab", MUSCLE)
    for path in (tmp_path / "lab").rglob("*.yaml"):
        first = path.read_text().splitlines()[0]
        if path.name != "answers.yaml":
            schema = json.loads((path.parent / first.partition("$schema=")[2]).read_text())
            assert "properties" in schema or "oneOf" in schema


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    assert "not an empty folder" in answered(tmp_path, MUSCLE, code=2)
    assert "not an empty folder" in answered(tmp_path / "mine", MUSCLE, code=2)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_where_nothing_can_be_written_that_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "no lab folder can be written here" in answered(tmp_path / "file" / "lab", MUSCLE, code=7)
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_nothing_is_left_where_a_disk_fills_up_on_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, written = Path.write_text, []

    def full(self: Path, text: str, **options: str) -> int:
        written.append(self)
        if len(written) > 4:
            raise OSError(28, "No space left on device")
        return real(self, text, **options)

    monkeypatch.setattr(Path, "write_text", full)
    assert "No space left on device" in answered(tmp_path / "lab", MUSCLE, code=7)
    assert not (tmp_path / "lab").exists()
