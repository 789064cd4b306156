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


@pytest.mark.parametrize("bench", ["mock-linear", "wires"])
def test_what_it_writes_passes_check_where_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bench: str) -> None:
    folder = tmp_path / "lab"
    told = json.loads(call("init", str(folder), "--bench", bench, "--json"))
    assert told["files"] == sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert {"README.md", "bench.yaml", "specimen.yaml", "protocol.yaml"} < set(told["files"])
    monkeypatch.chdir(folder)
    assert "nothing was sent to a bench" in call(*CHECK)
    # nothing is taken from anywhere else: an own word in an own file is seen
    calibration = next(Path("calibrations").glob("*-P.yaml"))
    calibration.write_text("schema: pmabench.calibration/1\n")
    assert calibration.name in call(*CHECK, code=3)


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
