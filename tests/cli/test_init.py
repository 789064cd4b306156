"""`init`: what it writes passes `check` where it lies, and it writes nowhere but into an empty folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main

CHECK = ("check", "protocol.yaml", "--bench", "bench.yaml", "--specimen", "specimen.yaml")


def call(*arguments: str, code: int = 0) -> str:
    result = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def write_lab(folder: Path, bench: str) -> None:
    told = json.loads(call("init", str(folder), "--bench", bench, "--json"))
    assert told["files"] == sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert {"README.md", "bench.yaml", "specimen.yaml", "protocol.yaml"} < set(told["files"])


def test_a_simulated_lab_passes_check_where_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_lab(tmp_path / "lab", "mock-linear")
    monkeypatch.chdir(tmp_path / "lab")
    assert "nothing was sent to a bench" in call(*CHECK)
    # nothing is taken from anywhere else: an own word in an own file is seen
    calibration = next(Path("calibrations").glob("*-P.yaml"))
    calibration.write_text("schema: pmabench.calibration/1\n")
    assert calibration.name in call(*CHECK, code=3)


FILLED = {
    "WIRES-P": ("2026-11-20", "[[0 kPa, 0 kPa], [1000 kPa, 1000 kPa]]", "1 kPa"),
    "WIRES-X": ("2026-11-20", "[[0 mm, 0 mm], [90 mm, 90 mm]]", "20 um"),
    "WIRES-F": ("2026-11-20", "[[0 N, 0 N], [1950 N, 1950 N]]", "1 N"),
}
"""What a lab writes into each calibration: date, points, uncertainty."""


def test_a_lab_with_devices_is_refused_until_all_is_filled_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the simulated muscle goes along: neither its calibrations nor its coefficients nor its serial."""
    write_lab(tmp_path / "lab", "wires")
    monkeypatch.chdir(tmp_path / "lab")
    texts = "".join(path.read_text() for path in Path().rglob("*.yaml"))
    for word in ("simulated plant", "MOCK-P0", "F_ce:", "simulated muscle"):
        assert word not in texts, word
    told = call(*CHECK, code=3)
    for place in ("specimen.yaml:4:", "calibrations/WIRES-F.yaml:7:"):
        assert place in told
    assert told.count("not filled in yet (??): write here what is true at your bench") == 11 + 3 * 4
    for name, values in FILLED.items():
        path = Path("calibrations") / f"{name}.yaml"
        text = path.read_text()
        for key, value in zip(
            ("reference", "date", "points", "expanded_uncertainty"), ("gauge 4711", *values), strict=True
        ):
            text = text.replace(f"\n{key}: ??", f"\n{key}: {value}")
        path.write_text(text)
    assert "calibrations" not in call(*CHECK, code=3)
    shipped = Path(__file__).resolve().parents[2] / "fixtures" / "specimens" / "mas-20-250-paper0.yaml"
    Path("specimen.yaml").write_text(shipped.read_text())
    assert "nothing was sent to a bench" in call(*CHECK)


def test_a_file_of_ones_own_is_copied_as_it_is(tmp_path: Path) -> None:
    shipped = Path(__file__).resolve().parents[2] / "fixtures" / "specimens" / "mas-20-250-paper0.yaml"
    (tmp_path / "mine.yaml").write_text(shipped.read_text().replace("MOCK-P0", "LAB-1"))
    call("init", str(tmp_path / "lab"), "--bench", "wires", "--specimen", str(tmp_path / "mine.yaml"))
    assert "serial: LAB-1" in (tmp_path / "lab" / "specimen.yaml").read_text()


def test_editors_find_the_schemas_in_the_folder(tmp_path: Path) -> None:
    call("init", str(tmp_path / "lab"), "--bench", "wires")
    for path in (tmp_path / "lab").rglob("*.yaml"):
        first = path.read_text().splitlines()[0]
        if "$schema=" in first and path.parent.name != "registers":
            schema = json.loads((path.parent / first.partition("$schema=")[2]).read_text())
            assert "properties" in schema or "oneOf" in schema


def test_the_commands_of_the_readme_are_told(tmp_path: Path) -> None:
    out = call("init", str(tmp_path / "lab"))
    readme = (tmp_path / "lab" / "README.md").read_text()
    assert "simulated" in out
    for command in ("check", "run"):
        assert f"pmabench {command} {' '.join(CHECK[1:])}" in readme


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    assert "not an empty folder" in call("init", str(tmp_path), code=2)
    assert "not an empty folder" in call("init", str(tmp_path / "mine"), code=2)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine").read_text() == "mine"
    (tmp_path / "empty").mkdir()
    call("init", str(tmp_path / "empty"))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--bench", "mok"), 'did you mean "mock"'),
        (("--protocol", "arm-angle"), "arm"),
        (("--specimen", "nothing"), "no shipped specimen"),
    ],
)
def test_what_does_not_go_together_is_refused_and_nothing_is_written(
    tmp_path: Path, options: tuple[str, str], told: str
) -> None:
    assert told in call("init", str(tmp_path / "lab"), *options, code=3)
    assert not (tmp_path / "lab").exists()


def test_where_nothing_can_be_written_that_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "no lab folder can be written here" in call("init", str(tmp_path / "file" / "lab"), code=7)
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_nothing_is_left_where_a_disk_fills_up_on_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, written = Path.write_text, []

    def full(self: Path, text: str) -> int:
        written.append(self)
        if len(written) > 5:
            raise OSError(28, "No space left on device")
        return real(self, text)

    monkeypatch.setattr(Path, "write_text", full)
    assert "No space left on device" in call("init", str(tmp_path / "lab"), code=7)
    assert len(written) == 6
    assert not (tmp_path / "lab").exists()
