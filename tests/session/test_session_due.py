"""What `check` says of the session that comes before a run: due only where none counts."""

import json

from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.session import ensure
from tests.cli.test_cli import call
from tests.engine.benches import mounted

CHECK = ["check", "static-load", "--bench", "mock-session", "--specimen", "mas-20-250-paper0"]


def test_check_names_the_session_where_it_is_due_and_not_where_one_counts(tmp_path):
    alone = json.loads(call(*CHECK[:3], "mock", *CHECK[4:], "--json").stdout)
    assert alone["session"] is None
    due = json.loads(call(*CHECK, "--json").stdout)
    assert due["session"]["due"]
    assert due["duration"] == alone["duration"]
    assert "comes first and is not in that: self-test, warm-up of 20.0 s, zeros" in " ".join(
        call(*CHECK).stdout.split()
    )
    ensure(mounted("mock-session"), ConfirmedBeforehand(), tmp_path / "runs")
    assert not json.loads(call(*CHECK, "--json").stdout)["session"]["due"]
    assert "the last one still counts" in call(*CHECK).stdout
