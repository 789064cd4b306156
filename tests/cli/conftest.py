"""What several tests of commands share: the analysis of a campaign as a surface."""

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan

SLOW = ("real-muscle-ramps", "real-muscle-pressurisation", "real-muscle-sines")


def ran(out, protocol, bench, settings):
    prepared = prepare(protocol, bench, "dmsp-20-250-real", settings)
    outcome = run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=out)
    assert outcome.status == "finished", outcome.why
    return str(outcome.folder)


@pytest.fixture(scope="session")
def surface(tmp_path_factory):
    """The folder of the analysis of three slow tests."""
    out = tmp_path_factory.mktemp("surface")
    runs = [ran(out / "runs", protocol, "mock-real-actuator", []) for protocol in SLOW]
    result = CliRunner().invoke(main, ["process", *runs, "--form", "surface", "--out", str(out / "found"), "-q"])
    assert result.exit_code == 0, result.output
    return out / "found"
