"""A path with turns on the mock bench: PI alone, and with the feed-forward of a muscle that was found as a surface."""

import json

import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from tests.cli.conftest import ran

PATH = [
    ("trial.path", "{shares: [100 %, 40 %, 80 %, 20 %], speed: 20 mm/s, rest: 0.5 s}"),
    ("sample_rate", "100 Hz"),
    ("sweep.repeat.count", "1"),
]


def test_the_inverse_takes_most_of_the_error_off(surface, tmp_path):
    runs = [
        ran(
            tmp_path / "runs",
            "positioning-path",
            "mock-real",
            [*PATH, ("model.coefficients", str(surface)), ("controller.feedforward", ahead)],
        )
        for ahead in ("false", "true")
    ]
    result = CliRunner().invoke(main, ["process", *runs, "--json"])
    assert result.exit_code == 0, result.output
    (analysis,) = json.loads(result.stdout)["analyses"]
    error = {e["method"]: e["value"] for e in analysis["estimates"] if e["symbol"] == "e_rms"}
    assert error["along a path, with feed-forward"] < 0.4e-3
    assert error["along a path"] > 3 * error["along a path, with feed-forward"]
    page = tmp_path / "page.html"
    shown = CliRunner().invoke(main, ["report", *runs, "-o", str(page)])
    assert shown.exit_code == 0, shown.output
    assert "Along a path" in page.read_text()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([("controller.feedforward", "true")], "as a surface"),
        ([("trial.path.shares", "[120 %]")], "between 0 % and 100 %"),
        ([("trial.path.speed", "0 mm/s")], "speed"),
    ],
)
def test_what_cannot_be_done_is_said(settings, words):
    without_rule = [("model.coefficients", "paper0 bench"), ("controller.rule", "Ziegler-Nichols")]
    with pytest.raises(InvalidFile, match=words):
        prepare("positioning-path", "mock-real", "dmsp-20-250-real", [*without_rule, *settings])
