"""A file whose units, gains or columns cannot be right gives no value until somebody has confirmed it."""

import json

import numpy as np

from pmabench.kinds.reduce import verdicts
from pmabench.store.analyses.results import Analysis, Estimate, Parts, withhold
from tests.calls import call
from tests.store.plausible_files import damaged, isometric

MAP = """\
schema: pmabench.map/1
name: a test of doubts
source: made here
kind: isometric
file: {delimiter: comma, header: first line}
columns:
  t: {is: time, unit: s}
  p: {is: pressure, unit: kPa}
  f: {is: force, unit: N}
sampling: {rate: [10 Hz, 2000 Hz], gap: 1 s}
trials: {by: file, point: {contraction: 0 mm}}
specimen: {type: muscle, serial: "1", nominal_length: 300 mm}
analysis: {force_above: 20 N}
"""


def processed(folder, files, more="", code=0):
    """The isometric analysis of files, and what `process` says."""
    paths = []
    for number, file in enumerate(files):
        paths.append(folder / f"test{number}.csv")
        table = np.column_stack([file.t, file.pressure, file.force])
        np.savetxt(paths[-1], table, delimiter=",", header="t,p,f", comments="", fmt="%.8g")
    (folder / "map.yaml").write_text(MAP + more)
    reported = call("import", *paths, "--map", folder / "map.yaml", "--out", folder / "runs", "--json").stdout
    runs = [entry["run"] for entry in json.loads(reported)["runs"]]
    said = call("process", *runs, "--out", folder / "out", code=code).output
    return json.loads((folder / "out" / "isometric" / "analysis.json").read_text()), said


def slope(analysis):
    return next(e for e in analysis["estimates"] if e["symbol"] == "m")


def test_bar_called_kpa_withholds_the_slope_until_it_is_confirmed(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    file = isometric(1)
    bad = damaged(file, pressure=file.pressure / 100.0)
    analysis, said = processed(tmp_path / "a", [bad], code=6)
    assert slope(analysis)["withheld"]
    assert slope(analysis)["value"] is None
    assert analysis["curves"][0]["terms"][0]["value"] is None
    assert "is it bar?" in said
    assert "confirmed: [magnitude]" in said
    analysis, said = processed(tmp_path / "b", [bad], "confirmed: [magnitude]\n")
    assert slope(analysis)["value"] is not None
    assert "confirmed in the map" in json.dumps(analysis["findings"])


def test_two_files_in_different_units_are_not_pooled(tmp_path):
    one, two = isometric(1), isometric(1, rate=90.0)
    analysis, said = processed(tmp_path, [one, damaged(two, force=two.force * 0.57)], code=6)
    assert slope(analysis)["withheld"]
    assert "no repeats of one test" in " ".join(said.split())


def test_one_file_in_other_units_among_four_withholds_all(tmp_path):
    files = [isometric(1, rate=rate) for rate in (100.0, 95.0, 90.0, 85.0)]
    files[2] = damaged(files[2], force=files[2].force * 0.57)
    analysis, said = processed(tmp_path, files, code=6)
    assert slope(analysis)["withheld"]
    assert "no repeats of one test" in " ".join(said.split())


def test_one_reason_for_several_files_is_said_once():
    """With the first file and its number; the files themselves are in the findings."""
    notes = ("lab/held_4mm.csv: force: 6.9 N/kPa is too much", "lab/unheld.csv: force: 7.2 N/kPa is too much")
    estimates = tuple(
        withhold(Estimate("m", 1.0, "N/Pa", "force per pressure", "line", {"contraction": x}, Parts(), 1), note)
        for x, note in zip((0.004, 0.0), notes, strict=True)
    )
    analysis = Analysis("isometric", ("r1", "r2"), False, estimates)
    (said, *more) = verdicts([], [analysis])
    assert notes[0] in said
    assert more == []
