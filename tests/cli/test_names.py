"""What a person sees and types first: the sections of --help, examples, former names, completion, and `list`."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.cli.main import COMMANDS, SECTIONS, main
from pmabench.cli.names import RunFolder, in_full, short
from pmabench.files.shipped import find_file

ROOT = Path(__file__).resolve().parents[2]
MOST_NAMES = 28


def completed(*typed, incomplete=""):
    return [item.value for item in ShellComplete(main, {}, "pmabench", "_X").get_completions(list(typed), incomplete)]


def test_tab_completes_in_a_shell():
    """As the script of a shell asks, which no part of this program is asked for: in a process of its own."""
    typed = {"_PMABENCH_COMPLETE": "bash_complete", "COMP_WORDS": "pmabench run --bench labj", "COMP_CWORD": "3"}
    command = [sys.executable, "-m", "pmabench"]
    found = subprocess.run(command, env={**os.environ, **typed}, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (0, "")
    assert {"plain,labjack", "plain,labjack-t8"} <= set(found.stdout.split())


def test_help_shows_each_command_once_in_five_sections():
    reported = CliRunner().invoke(main, ["--help"]).stdout
    names = [name for section in SECTIONS.values() for name in section]
    assert len(SECTIONS) == 5
    assert len(names) == len(set(names)) <= MOST_NAMES
    assert [reported.index(f"\n{title}:\n") for title in SECTIONS] == sorted(
        reported.index(f"\n{t}:\n") for t in SECTIONS
    )
    assert all(f"\n  {name} " in reported for name in names)
    assert all(len(line) <= 80 for line in reported.splitlines())


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_each_help_ends_with_an_example_whose_options_exist(name):
    reported = CliRunner().invoke(main, [name, "--help"])
    assert (reported.exit_code, f"pmabench {name}" in reported.stdout.split("Example", 1)[-1]) == (0, True)
    command = main.get_command(click.Context(main), name)
    typed = shlex.split(COMMANDS[name][2])
    while isinstance(command, click.Group):
        command = command.commands[typed.pop(0)]
    command.make_context(name, typed)


def test_tab_completes_names_and_the_newest_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "benches" / "ours.yaml"
    own.parent.mkdir()
    own.write_text("# of our rig\nschema: pmabench.bench/1\nname: ours\n")
    (tmp_path / "other.yaml").write_text("schema: pmabench.specimen/1\n")
    for number in range(60):
        (tmp_path / "runs" / f"20261123-{number:04}_x").mkdir(parents=True)
    shipped = {path.stem for path in (ROOT / "fixtures" / "benches").glob("*.yaml")}
    assert set(completed("run", "--bench")) == {str(Path("benches/ours.yaml")), *shipped}
    assert completed("bench", "card", incomplete="fes") == ["festo-sine", "festo"]
    assert "other.yaml" in completed("run", "--specimen")
    assert completed("run", incomplete="static") == ["static-load-hands-at-pressure", "static-load"]
    runs = completed("process")
    assert (len(runs), runs[0]) == (50, str(Path("runs/20261123-0059_x")))
    assert completed("compare", incomplete="runs/20261123-0000") == ["runs/20261123-0000_x"]


def test_list_names_files_of_this_folder_and_shipped_ones(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text("schema: pmabench.bench/1\nname: our rig   # second floor\n")
    done = CliRunner().invoke(main, ["list", "benches", "--json"])
    rows = {row["name"]: row for row in json.loads(done.stdout)["files"]}
    assert (rows["rig.yaml"]["title"], rows["rig.yaml"]["from"]) == ("our rig", "here")
    assert (rows["mock"]["title"], rows["mock"]["from"]) == ("mock bench, weights, MAS-20-250 of paper 0", "shipped")
    reported = CliRunner().invoke(main, ["list", "-q"]).stdout.splitlines()
    assert {"mock", "contraction-relaxation", "demo", "paper0", "mas-20-250-paper0", "aarl-10mm"} <= set(reported)


def test_a_run_is_found_by_the_end_of_its_name_where_no_other_ends_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("runs/20261123-1702_M_3efe", "runs/20261123-1703_M_aaaa", "analyses/20261123-1704_M_aaaa"):
        (tmp_path / name).mkdir(parents=True)
    folder = RunFolder()
    one = Path("runs/20261123-1702_M_3efe")
    assert [folder.convert(typed, None, None) for typed in ("3efe", "runs/3efe", str(one))] == [one] * 3
    assert folder.convert("runs/aaaa", None, None) == Path("runs/20261123-1703_M_aaaa")
    assert folder.convert("ffff", None, None) == Path("ffff")
    with pytest.raises(click.BadParameter, match="the end of several names"):
        folder.convert("aaaa", None, None)
    assert short(tmp_path / one) == "runs/3efe"
    (tmp_path / "runs" / "20261123-1705_M_3efe").mkdir()
    assert short(tmp_path / one) == str(one)


def test_a_run_and_the_analysis_called_after_it_are_one_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("runs", "analyses"):
        (tmp_path / folder / "20261123-1702_M_3efe").mkdir(parents=True)
    assert in_full(Path("3efe")) == Path("runs/20261123-1702_M_3efe")
    assert in_full(Path("analyses/3efe")) == Path("analyses/20261123-1702_M_3efe")


@pytest.mark.parametrize("name", [*COMMANDS, "bench probe"])
def test_help_fits_80_columns_and_cuts_no_sentence(name):
    text = CliRunner().invoke(main, [*name.split(), "--help"], terminal_width=80).stdout
    assert [line for line in text.splitlines() if len(line) > 80] == []
    assert [line for line in text.splitlines() if re.fullmatch(r"  \w+  .*\.\.\.", line)] == []


def test_exchanged_files_are_named_and_a_wrong_name_brings_no_wall_of_names():
    with pytest.raises(InvalidFile, match="is a shipped specimen, where a bench is expected"):
        find_file("bench", "mas-20-250-paper0")
    with pytest.raises(InvalidFile) as caught:
        find_file("bench", "nowhere-near")
    assert "`pmabench list`" in str(caught.value)
    assert len(str(caught.value)) < 160
