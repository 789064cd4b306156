"""Clients in environments of their own, made by pip; on demand only (`make reliability PART=clients`)."""

import pytest

from tests.clients.harness import DISAGREES, run
from tests.clients.page import rows
from tests.clients.table import CLIENTS


@pytest.mark.parametrize("client", [client for client in CLIENTS if client.package], ids=lambda client: client.name)
def test_every_call_comes_out_as_the_page_says(client, tmp_path):
    states = {result.call: (result.state, result.why) for result in run(client, tmp_path)}
    reported = {name: state for state, names in rows()[client.what].items() for name in names}
    assert {name: why for name, (state, why) in states.items() if state == DISAGREES} == {}
    assert {name: state for name, (state, _why) in states.items()} == reported
