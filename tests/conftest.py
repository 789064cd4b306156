"""Generated cases are the same at every run; what outlives a process lies in a folder of the test, not the user's."""

import os
import tempfile

import pytest
from hypothesis import settings

import pmabench.cli.main  # noqa: F401  (sets the number of BLAS threads before numpy is loaded, as for a user)

settings.register_profile("same", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("same")

os.environ["PMABENCH_STATE"] = tempfile.mkdtemp(prefix="pmabench-state-")


@pytest.fixture(autouse=True)
def _own_state(tmp_path, monkeypatch):
    """Locks and latches of one test are not those of another."""
    monkeypatch.setenv("PMABENCH_STATE", str(tmp_path / "state"))
