"""`watch --web` and `run --web` as they are typed."""

import http.client
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.cli.watch import TOKEN_HOURS, token
from tests.display.recorded import Recorded

POINTS = [(58.86, 3e5)]


@pytest.fixture
def runs(tmp_path):
    run = Recorded(tmp_path / "runs", POINTS)
    run.trial(0)
    run.close()
    return run.folder.parent


def history(address):
    """Status of a request with the token of an address."""
    link, _, key = address.partition("#t=")
    host = link.split("/")[2]
    connection = http.client.HTTPConnection(host, timeout=10)
    connection.request("GET", "/api/history", headers={"Authorization": f"Bearer {key}"})
    status = connection.getresponse().status
    connection.close()
    return status


def test_it_prints_its_address_serves_and_ends_by_a_signal(runs):
    command = [sys.executable, "-m", "pmabench", "watch", "--web", "--json", str(runs)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as serving:
        said = json.loads(serving.stdout.readline())
        assert said["schema"] == "pmabench.web/1"
        assert said["address"].startswith("http://127.0.0.1:")
        assert history(said["address"]) == 200
        assert history(said["address"][:-1]) == 401
        serving.terminate()
        assert serving.wait(20) == 143


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--vent"], "belong to --web"),
        (["--listen", "127.0.0.1"], "belong to --web"),
        (["--web", "--listen", "0.0.0.0"], "every network"),
        (["--web", "--listen", "my-computer"], "needs an address"),
        (["--web", "--listen", "192.0.2.7"], "is it an address of this computer"),
        (["--web", "--vent", "--listen", "192.0.2.7"], "this computer only"),
    ],
)
def test_what_cannot_be_served_is_said(runs, options, why):
    said = CliRunner().invoke(main, ["watch", str(runs), *options])
    assert said.exit_code == 2
    assert why in said.output


def test_a_token_is_kept_for_hours_where_only_its_user_can_read_it():
    first = token()
    kept = next(path for path in Path(os.environ["PMABENCH_STATE"]).iterdir())
    assert len(first) == 22  # 128 bits, six to a character
    assert token() == first
    assert kept.stat().st_mode & 0o777 == 0o600
    before = time.time() - TOKEN_HOURS * 3600 - 1
    os.utime(kept, (before, before))
    assert token() != first


def test_a_run_says_where_it_is_seen_and_does_not_wait_for_it(tmp_path):
    words = ["run", "contraction-relaxation", "--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes", "--web"]
    words += ["--set", "sweep.matrix.load=[6 kg]", "--set", "sweep.matrix.pressure=[300 kPa]"]
    ended = subprocess.run(
        [sys.executable, "-m", "pmabench", *words, "--set", "sweep.repeat.count=1", "--out", str(tmp_path / "runs")],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    address = next(line for line in ended.stderr.splitlines() if line.startswith("in a browser: ")).split()[-1]
    until = time.monotonic() + 20.0
    while history(address) == 404 and time.monotonic() < until:
        time.sleep(0.2)  # a run in virtual time is over before the view has looked for it
    assert history(address) == 200  # still there for who looks at the end


@pytest.mark.parametrize("vent", [True, False])
def test_the_view_of_a_run_has_a_vent_button_only_where_it_was_asked_for(monkeypatch, vent):
    from pmabench.cli.common import Ui
    from pmabench.cli.watch import start_view

    started = []

    def popen(command, **_options):
        started.append(command)
        raise OSError

    monkeypatch.setattr("pmabench.cli.watch.subprocess.Popen", popen)
    start_view(Ui(), Path("runs"), vent=vent)
    assert ("--vent" in started[0]) == vent
    assert started[0][4:6] == ["watch", "--web"]


def test_a_vent_button_needs_a_view():
    words = ["run", "contraction-relaxation", "--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes", "--vent"]
    said = CliRunner().invoke(main, words)
    assert said.exit_code == 2
    assert "--vent belongs to --web" in said.output


def test_without_a_view_the_run_goes_on(tmp_path, monkeypatch, capsys):
    from pmabench.cli.common import Ui
    from pmabench.cli.watch import start_view

    monkeypatch.setattr("pmabench.cli.watch.sys.executable", str(tmp_path / "nowhere"))
    start_view(Ui(), Path("runs"))
    assert "the run goes on without it" in capsys.readouterr().err
