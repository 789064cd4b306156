"""The `accept` section: what it can hold for which kind, with its place in the file; what it becomes in the plan."""

from __future__ import annotations

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.kinds.compile import make_plan
from tests.protocol.test_compile import ROOT, mounted

TEXT = (ROOT / "protocols" / "contraction-relaxation.yaml").read_text().split("\naccept:")[0]


def plan(tmp_path, accept, text=TEXT, bench=None):
    path = tmp_path / "mine.yaml"
    path.write_text(f"{text}\naccept:\n{accept}\n")
    return make_plan(path, mounted() if bench is None else bench)[0]


def test_every_limit_is_in_the_plan_with_its_line(tmp_path):
    accept = plan(
        tmp_path,
        "  K: {relative_interval: 2 %, of_specimen: 5 %}\n  F_c: {of_specimen: 20 %}\n  drift: {at_most: 1 %}",
    ).accept
    line = TEXT.count("\n") + 3
    assert accept["K"] == 0.02
    reported = [(entry["what"], entry["measure"], entry["limit"], entry["place"]) for entry in accept["limits"]]
    assert reported == [
        ("K", "relative_interval", 0.02, f"mine.yaml:{line}"),
        ("K", "of_specimen", pytest.approx(0.05), f"mine.yaml:{line}"),
        ("F_c", "of_specimen", pytest.approx(0.2), f"mine.yaml:{line + 1}"),
        ("drift", "at_most", pytest.approx(0.01), f"mine.yaml:{line + 2}"),
    ]
    assert (3e5, 6770.0) in [(P, pytest.approx(K)) for P, K in accept["limits"][1]["expected"]]
    assert accept["limits"][2]["expected"] == 6.0


@pytest.mark.parametrize(
    ("accept", "reported"),
    [
        ("  K: {}", "says no limit; expected relative_interval or of_specimen"),
        ("  K: {at_most: 3 %}", "K has no at_most; expected relative_interval or of_specimen"),
        ("  drift: {relative_interval: 3 %}", "drift has no relative_interval; expected at_most"),
        ("  repeat_spread: {at_most: 0 %}", "a limit is above 0 %"),
        ("  repeat_spraed: {at_most: 1 %}", "repeat_spread"),
        ("  B: {of_specimen: 5 %}", "does not give B"),
    ],
)
def test_what_cannot_be_judged_is_refused(tmp_path, accept, reported):
    with pytest.raises(InvalidFile, match="mine.yaml:") as caught:
        plan(tmp_path, accept)
    assert reported in str(caught.value)


def test_a_kind_without_checks_says_so(tmp_path):
    text = (ROOT / "protocols" / "ultimate-gain.yaml").read_text()
    from tests.protocol.test_compile import BENCH_OF

    with pytest.raises(InvalidFile, match="gives nothing of the kind; it gives K_u, T_u"):
        plan(tmp_path, "  drift: {at_most: 1 %}", text, mounted(BENCH_OF["ultimate-gain"]))
