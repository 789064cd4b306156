"""What `check` says of a session's length, against the session when it is held; due only where none counts."""

import json

from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.session import ensure
from pmabench.session.session import session_length
from pmabench.store.reader import open_run
from tests.cli.test_cli import call
from tests.engine.benches import mounted

CHECK = ["check", "static-load", "--bench", "mock-session", "--specimen", "mas-20-250-paper0"]


def test_a_session_lasts_between_its_shortest_and_its_longest(tmp_path):
    bench = mounted("mock-session")
    length = session_length(bench)
    ensure(bench, ConfirmedBeforehand(), tmp_path / "runs")
    run = open_run(next((tmp_path / "runs").iterdir()))
    (vent,) = [event.t for event in run.events if event.kind == "vent"]
    assert 0.8 * vent < length.shortest < vent < length.longest
    assert length.hands == sum(event.kind == "prompt" for event in run.events)
    assert session_length(mounted("mock")) is None


def test_check_counts_the_session_where_it_is_due_and_not_where_one_counts(tmp_path):
    alone = json.loads(call(*CHECK[:3], "mock", *CHECK[4:], "--json").stdout)["duration"]["shortest"]
    due = json.loads(call(*CHECK, "--json").stdout)
    assert due["session"]["due"]
    assert due["duration"]["shortest"] == alone + due["session"]["shortest"]
    assert "self-test, warm-up, zeros" in " ".join(call(*CHECK).stdout.split())
    ensure(mounted("mock-session"), ConfirmedBeforehand(), tmp_path / "runs")
    kept = json.loads(call(*CHECK, "--json").stdout)
    assert (kept["session"]["due"], kept["duration"]["shortest"]) == (False, alone)
    assert "the last one still counts" in call(*CHECK).stdout
