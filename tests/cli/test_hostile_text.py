"""No text of a file, a run or an argument is obeyed by the terminal, whichever command prints it."""

import json
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.base.text import Spelled, raw, spelled
from pmabench.cli.main import main
from tests.cli.test_cli import call
from tests.store.runs import closed

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = "zz\x1b]52;c;b3du\x07\x1b[31m\x9b5n\u202etxt\x08\r"
"""Writes to the clipboard, rings, colours, asks the terminal, turns text round, goes back."""
NEVER = ["\x1b]", "\x07", "\x9b", "\u202e", "\x08", "\x1b[31m"]
SMALL = ["--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[200 kPa, 300 kPa]"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A protocol, a bench and a specimen with a hostile name, a campaign of them, a run and its analysis."""
    folder = tmp_path_factory.mktemp("lab")
    name = json.dumps(HOSTILE)  # YAML reads a JSON string as it is
    protocol = (ROOT / "protocols" / "contraction-relaxation.yaml").read_text()
    (folder / "protocol.yaml").write_text(named(protocol, "name", "source"))
    shutil.copytree(ROOT / "fixtures" / "benches", folder / "benches")
    (folder / "bench.yaml").write_text(f"include: benches/mock.yaml\nname: {name}\n")
    specimen = (ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml").read_text()
    (folder / "specimen.yaml").write_text(named(specimen, "make", "serial"))
    campaign = f"schema: pmabench.campaign/1\nname: {name}\nspecimen: specimen.yaml\nbenches: {{weights: bench.yaml}}\n"
    settings = "{sweep.matrix.load: [6 kg], sweep.matrix.pressure: [200 kPa], sweep.repeat.count: 1}"
    (folder / "campaign.yaml").write_text(f"{campaign}runs:\n  - protocol: protocol.yaml\n    set: {settings}\n")
    (folder / "wrong.yaml").write_text(f"schema: pmabench.protocol/1\nkind: {name}\n")
    reported = call(
        "run", folder / "protocol.yaml", *bench(folder), *SMALL, "--yes", "--out", folder / "runs", "--json"
    )
    run = json.loads(reported.stdout)["run"]
    call("process", run, "--out", folder / "analysis", code=6)
    made = closed(folder / "named", rows=20, operator=HOSTILE, protocol=HOSTILE, source=HOSTILE, bench=HOSTILE)
    (made / f"{HOSTILE}.txt").write_text("x")
    return folder, run, made


def named(text, *keys):
    """YAML with the hostile name under each key."""
    for key in keys:
        text = re.sub(rf"^{key}: .*", lambda _line, key=key: f"{key}: {json.dumps(HOSTILE)}", text, flags=re.MULTILINE)
    return text


def bench(folder):
    return ["--bench", folder / "bench.yaml", "--specimen", folder / "specimen.yaml"]


END = "-- the next command --"
TYPED = f"""
import json, sys
from pmabench.cli.main import main

own = sys.stdout, sys.stderr
for words in json.loads(sys.argv[1]):
    sys.stdout, sys.stderr = own
    try:
        main(words, prog_name="pmabench")
    except SystemExit:
        pass
    for stream in own:
        stream.flush()
    own[0].write("{END}")
"""
"""One command after the other, each with the streams that a program begins with."""


def on_a_terminal(commands):
    """What a program sends to its terminal, command by command."""
    ours, theirs = pty.openpty()
    typed = json.dumps([[str(word) for word in command] for command in commands])
    program = [sys.executable, "-c", TYPED, typed]
    with subprocess.Popen(program, stdin=theirs, stdout=theirs, stderr=theirs, cwd=ROOT):
        os.close(theirs)
        found, until = b"", time.monotonic() + 120
        while time.monotonic() < until and select.select([ours], [], [], 120)[0]:
            try:
                piece = os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
            found += piece
    os.close(ours)
    return found.decode().split(END)[:-1]


COMMANDS = {
    "check": lambda lab, run, made: ("check", lab / "protocol.yaml", *bench(lab), *SMALL),
    "check --plan": lambda lab, run, made: ("check", lab / "protocol.yaml", *bench(lab), *SMALL, "--plan"),
    "a wrong file": lambda lab, run, made: ("check", lab / "wrong.yaml", *bench(lab)),
    "no such file": lambda lab, run, made: ("runs", "show", lab / HOSTILE),
    "no such command": lambda lab, run, made: (HOSTILE,),
    "no such option": lambda lab, run, made: ("check", "x", *bench(lab), "--set", HOSTILE),
    "run": lambda lab, run, made: ("run", lab / "protocol.yaml", *bench(lab), *SMALL, "--yes", "--out", lab / "again"),
    "campaign": lambda lab, run, made: ("campaign", lab / "campaign.yaml", "--yes", "--out", lab / "campaign"),
    "runs list": lambda lab, run, made: ("runs", "list", made.parent),
    "runs show": lambda lab, run, made: ("runs", "show", made),
    "runs verify": lambda lab, run, made: ("runs", "verify", made),
    "watch": lambda lab, run, made: ("watch", made),
    "watch --plain": lambda lab, run, made: ("watch", run, "--plain"),
    "process": lambda lab, run, made: ("process", run, "--out", lab / "processed"),
    "compare": lambda lab, run, made: ("compare", lab / "analysis" / "contraction-relaxation", run),
    "history": lambda lab, run, made: ("history", lab / "runs"),
    "note": lambda lab, run, made: ("note", made, HOSTILE, "--operator", HOSTILE),
}
SILENT = {"note", "watch --plain", "process", "compare", "run", "history", "watch", "no such option"}
"""Commands that print ids, which never hold such signs, or a part of the text only."""


def test_a_hostile_name_reaches_the_terminal_as_plain_signs(lab):
    printed = on_a_terminal(command(*lab) for command in COMMANDS.values())
    for name, text in zip(COMMANDS, printed, strict=True):
        assert len(text) > 40, name
        assert "Traceback" not in text, name
        for sign in NEVER:
            assert sign not in text, (name, text)
        assert "\r" not in text.replace("\r\n", "").replace("\r\x1b[2K", ""), name
        assert "zz" in text or name in SILENT, (name, text)


def test_json_escapes_it_and_loses_nothing(lab):
    folder, _run, made = lab
    done = CliRunner().invoke(main, ["check", *map(str, (folder / "protocol.yaml", *bench(folder))), *SMALL, "--json"])
    assert json.loads(done.stdout)["name"] == HOSTILE
    assert not any(sign in done.stdout for sign in NEVER)
    shown = CliRunner().invoke(main, ["runs", "show", str(made), "--json"])
    assert json.loads(shown.stdout)["manifest"]["operator"] == HOSTILE


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("plain text,\n\tin lines: äöü 空 ±", "plain text,\n\tin lines: äöü 空 ±"),
        ("a\x1b[31mb", "a\\x1b[31mb"),
        ("\x00\x07\x08\x0b\x0c\r\x7f\x9b", "\\x00\\x07\\x08\\x0b\\x0c\\r\\x7f\\x9b"),
        ("\u202e\u2066\u200f\ufeff\U000e0041", "\\u202e\\u2066\\u200f\\ufeff\\U000e0041"),
        ("نام\u200cها", "نام\u200cها"),
    ],
)
def test_signs_that_a_terminal_obeys_are_shown_as_in_source_code(given, shown):
    assert spelled(given) == shown


def test_the_streams_of_a_command_have_no_way_round(capsys):
    stream = Spelled(sys.stdout)
    stream.writelines(["a\x1b", "b\x07\n"])
    print("c\x1b]0;x\x07", file=stream)
    assert capsys.readouterr().out == "a\\x1bb\\x07\nc\\x1b]0;x\\x07\n"
    assert not hasattr(stream, "buffer")
    assert stream.encoding == sys.stdout.encoding
    assert raw(stream) is sys.stdout
    assert raw(sys.stdout) is sys.stdout
