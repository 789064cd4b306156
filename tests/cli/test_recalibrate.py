"""Another calibration of the same raw samples changes each coefficient as its equation says, and nothing on disk."""

import hashlib
import json
from dataclasses import replace
from math import hypot

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.report.document.content import content_of
from pmabench.store.analyses.folder import read_analysis
from pmabench.store.analyses.results import Analysis
from pmabench.store.reader import NewScale, Recalibration, open_run, refound
from tests.benchmarks.archive import write_run
from tests.calls import call
from tests.report.samples import render
from tests.store.runs import closed

LENGTH = """schema: pmabench.calibration/1
id: {id}
quantity: {quantity}
reference: gauge blocks
date: 2026-03-01
points: [[0 {raw}, {low}], [50000 {raw}, {high}]]
expanded_uncertainty: {uncertainty}
gain_uncertainty: 0.2 %
"""
ONE_PERCENT = {
    "id": "C-2",
    "quantity": "length",
    "raw": "count",
    "low": "0 mm",
    "high": "101 mm",
    "uncertainty": "1 um",
}
"""The archive's displacement has 2 um a count: this is 1 % more."""


def file(folder, **changes):
    reported = ONE_PERCENT | changes
    path = folder / f"{reported['id']}.yaml"
    path.write_text(LENGTH.format(**reported))
    return path


def tree(folder):
    return {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("lab") / "runs", 3)


def changed(reported):
    return {(c["symbol"], bool(c["at"])): c for c in reported["changes"]}


def test_a_scale_one_percent_larger_changes_strokes_and_nothing_that_rests_on_time(run, tmp_path):
    before = tree(run)
    reported = json.loads(call("recalibrate", run, "--calibration", file(tmp_path), "--json").stdout)
    found = changed(reported)
    stroke, slope, K, B = (found[name, True] for name in ("X", "dP/dx", "K", "B"))
    assert stroke["after"]["value"] == pytest.approx(1.01 * stroke["before"]["value"], rel=1e-12)
    assert stroke["difference"] == pytest.approx(0.01 * stroke["before"]["value"], rel=1e-9)
    assert slope["after"]["value"] == pytest.approx(slope["before"]["value"] / 1.01, rel=1e-12)
    for coefficient in (K, B):  # K = M w^2 and B = 2 D w M: mass and times, no length
        assert coefficient["after"]["value"] == pytest.approx(coefficient["before"]["value"], rel=1e-6)
    x = stroke["before"]["value"]
    assert stroke["half_width"] == pytest.approx(hypot(0.001 * x, 0.002 * 1.01 * x), rel=1e-9)
    assert reported["channels"][0]["sentence"] == "displacement: calibration C-2 instead of C-1"
    assert tree(run) == before
    (folder,) = reported["folders"]
    analysis = json.loads((run.parents[1] / folder / "analysis.json").read_text())
    assert analysis["findings"][0]["text"].startswith("recalibrated after the fact, displacement: calibration C-2")
    again = json.loads(call("recalibrate", run, "--calibration", file(tmp_path), "--json").stdout)
    assert again["folders"] != reported["folders"]
    assert again["changes"] == reported["changes"]


def test_a_report_names_both_calibrations_who_when_why_and_every_change(run, tmp_path):
    asked = ("--because", "wrong <b>gauge</b>", "--operator", "A. Meyer", "--out", tmp_path / "a", "--json")
    reported = json.loads(call("recalibrate", run, "--calibration", file(tmp_path), *asked).stdout)
    who = reported["recalibration"]
    assert (who["operator"], who["because"]) == ("A. Meyer", "wrong <b>gauge</b>")
    analysis = read_analysis(tmp_path / "a" / "recorded-step")
    content = content_of([analysis], [open_run(run)])
    rows = [[cell.text for cell in row] for _, rows in content.calibrations.groups for row in rows]
    heads = [column.head for column in content.calibrations.columns]
    recorded, reduced = heads.index("recorded with"), heads.index("reduced here with")
    by = {row[0]: (row[recorded], row[reduced]) for row in rows}
    assert by["displacement"][0] == "C-1"
    assert by["displacement"][1].startswith("C-2, 2026-03-01, gauge blocks, sha256 ")
    assert by["pressure"] == ("C-1", "")
    said = "by A. Meyer, because wrong <b>gauge</b>: displacement: calibration C-2 instead of C-1"
    assert content.deviations[0] == f"R1: recalibrated on {who['at'][:16].replace('T', ' ')} UTC {said}"
    (table,) = [t for t in content.sections[0].tables if t.caption.startswith("What the recalibration changed")]
    shown = [[cell.text for cell in row] for _, rows in table.groups for row in rows]
    assert len(shown) == len(reported["changes"])
    (stroke,) = [row for row in shown if row[1] == "X"]
    assert stroke[4:6] == ["40.00", "40.40"]
    assert stroke[-1] == "+1.00"
    page = render([analysis], [open_run(run)])
    assert "<b>gauge</b>" not in page
    plain = content_of([replace(analysis, facts={})], [open_run(run)])
    assert [column.head for column in plain.calibrations.columns][1] == "calibration"


@pytest.mark.parametrize("odd", [7, "x", [7], [{}], [{"scales": 3}], [{"channel": [], "scales": [{"after": 1}]}]])
def test_odd_facts_of_a_recalibration_make_no_trouble(run, odd):
    facts = {"recalibrated": odd, "recalibration": {"changes": odd, "at": 3, "because": [], "operator": {}}}
    content_of([Analysis("recorded-step", ("r",), False, facts=facts)], [open_run(run)])
    facts["recalibration"] = odd
    content_of([Analysis("recorded-step", ("r",), False, facts=facts)], [open_run(run)])


def test_the_same_calibration_changes_nothing(run, tmp_path):
    reported = json.loads(
        call(
            "recalibrate", run, "--calibration", file(tmp_path, high="100 mm"), "--out", tmp_path / "a", "--json"
        ).stdout
    )
    known = [c for c in reported["changes"] if c["before"]["value"] is not None]
    assert len(known) >= 5
    assert all(abs(c["difference"]) <= 1e-7 * abs(c["before"]["value"]) for c in known)
    assert all(c["difference"] is None for c in reported["changes"] if c not in known)


def test_a_pressure_that_is_late_moves_the_dead_time_by_as_much(run, tmp_path):
    out = ("--out", tmp_path / "a", "--json")
    reported = changed(json.loads(call("recalibrate", run, "--skew", "pressure=4 ms", *out).stdout))
    assert reported["t_d", False]["difference"] == pytest.approx(-0.004, abs=1e-9)
    assert abs(reported["X", True]["difference"]) < 1e-7  # of means of noise, of which one is over other samples


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        ((), 2, "give --calibration FILE or --skew CHANNEL=TIME"),
        (("--calibration", {"quantity": "pressure", "low": "0 kPa", "high": "1 kPa", "uncertainty": "1 Pa"}), 2,
         "say CHANNEL=FILE: channels that measure pressure: pressure, supply"),
        (("--calibration", {"raw": "V"}), 3, "displacement gives readings in count, the calibration is of V"),
        (("--calibration", {"quantity": "angle", "low": "0 deg", "high": "1 deg", "uncertainty": "1 deg"}), 2,
         "channels that measure angle: none"),
        (("--skew", "pressure"), 2, "is not CHANNEL=TIME"),
        (("--skew", "pressure=2 min"), 2, "more than 60 s"),
        (("--skew", "pressure=2"), 2, "is no time with a unit"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_reported_and_leaves_nothing_behind(run, tmp_path, options, code, says):
    asked = [file(tmp_path, **option) if isinstance(option, dict) else option for option in options]
    assert says in call("recalibrate", run, *asked, "--out", tmp_path / "out", code=code).output
    assert not (tmp_path / "out").exists()


def test_a_loop_that_acted_on_the_old_values_is_not_recalibrated(tmp_path):
    loop = closed(tmp_path, kind="ultimate-gain")
    asked = file(tmp_path)
    assert "its loop acted on the old values" in call("recalibrate", loop, "--calibration", asked, code=3).output


def test_what_a_search_found_moves_with_its_channel_and_a_zero_stays_zero(tmp_path):
    path = closed(tmp_path)
    was = open_run(path)
    old = was.channels["pressure"]
    new = NewScale("pressure", "count", 1.1 * old.slope, 500.0, {"id": "P-9"})
    now = open_run(path, anew=Recalibration({"pressure": new}))
    raw = (was.trials[0].channels["pressure"] - old.offset) / old.slope
    assert now.trials[0].channels["pressure"] == pytest.approx(raw * 1.1 * old.slope + 500.0, rel=1e-12)
    lift = was.trials[0].found["lift"]["pressure"]
    found = now.trials[0].found["lift"]["pressure"]
    assert found == pytest.approx((lift - old.offset) * 1.1 + 500.0, rel=1e-12)
    assert now.trials[0].found["lift"]["found"] is True
    assert now.channels["pressure"].calibration == "P-9"

    column = {"name": "pressure", "quantity": "pressure", "raw_unit": "count", "scale": {"slope": 2.0, "offset": -30.0}}
    about, lines = Recalibration({"pressure": new}).columns({"columns": [column | {"zero": 7.0}]}, "run")
    slope, offset = (about["columns"][0]["scale"][key] for key in ("slope", "offset"))
    assert slope * 15.0 + offset == pytest.approx(0.0)  # 15 counts read 0 before, by the session's zero
    assert refound(was.trials, lines)[0].found["lift"]["pressure"] == pytest.approx(lift * new.slope / 2.0)
    with pytest.raises(InvalidFile, match="gives readings in nothing that is known"):
        Recalibration({"pressure": new}).columns({"columns": [column | {"raw_unit": ""}]}, "run")
