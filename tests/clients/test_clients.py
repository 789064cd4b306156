"""Clients of the project's own environment agree with the emulators; the page says what the scripts try."""

import shutil

import pytest

from tests.clients.harness import AGREES, DISAGREES, FOLDER, NOT_TRIED, calls_of, run
from tests.clients.page import rows
from tests.clients.table import CLIENTS

OWN = (
    "__init__.py",
    "__main__.py",
    "harness.py",
    "own_environments.py",
    "page.py",
    "said.py",
    "table.py",
    "test_clients.py",
)


@pytest.mark.realtime
@pytest.mark.parametrize("client", [client for client in CLIENTS if not client.package], ids=lambda client: client.name)
def test_every_call_comes_out_as_the_page_says(client, tmp_path):
    if client.program and shutil.which(client.program) is None:
        pytest.skip(f"not run: no {client.program}")
    states = {result.call: (result.state, result.why) for result in run(client, tmp_path)}
    reported = {name: state for state, names in rows()[client.what].items() for name in names}
    assert {name: why for name, (state, why) in states.items() if state == DISAGREES} == {}
    assert {name: state for name, (state, _why) in states.items()} == reported


def test_the_page_names_the_calls_of_every_script():
    for client in CLIENTS:
        row = rows()[client.what]
        assert sorted(row[AGREES] + row[DISAGREES] + row[NOT_TRIED]) == sorted(calls_of(client.script)), client.name


def test_every_script_is_a_client():
    scripts = {path.name for path in FOLDER.glob("*.py")} - {*OWN}
    assert {client.script for client in CLIENTS} == scripts
    assert [client.what for client in CLIENTS] == [*rows()]


def test_no_script_imports_the_project():
    for client in CLIENTS:
        text = (FOLDER / client.script).read_text("utf-8")
        assert "pmabench" not in text
        assert "from tests" not in text
