"""`compare` from folders and tables to sentences, JSON and a page; exit 6 beyond a limit; bad input in a sentence."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pmabench.store.analyses.folder import write_analysis
from pmabench.store.analyses.results import Analysis, Estimate, Parts, Trace
from tests.calls import call

EVIL = '<script>alert(1)</script>"\x1b[31m=1+1'


def estimates(K, F_ce, half=20.0):
    for P, k, f in zip((2e5, 3e5, 4e5), K, F_ce, strict=True):
        yield Estimate("K", k, "N/m", "stiffness", "measured-pressure", {"pressure": P}, Parts(half), 4)
        yield Estimate("F_ce", f, "N", "force", "measured-pressure", {"pressure": P}, Parts(2.0), 4)


@pytest.fixture
def folders(tmp_path):
    """Two analyses: K 1 %, 0 and 0.1 % apart, F_ce the same."""
    kind = "contraction-relaxation"
    one = Analysis(kind, ("r1",), False, tuple(estimates((6060.0, 7000.0, 8008.0), (160.0, 270.0, 380.0))))
    two = Analysis(kind, ("r2",), True, tuple(estimates((6000.0, 7000.0, 8000.0), (160.0, 270.0, 380.0))))
    return [write_analysis(a, tmp_path / name / kind) for name, a in (("one", one), ("two", two))]


def test_differences_are_reported_with_their_e_n(folders):
    one, two = folders
    text = call("compare", one.parent, two).output
    assert "K: differ by more than their interval at 1 of 3 points; furthest apart at 200 kPa: +0.06 N/mm" in text
    assert "F_ce: agree at all 3 points" in text
    assert "B is SIMULATED, the other is not" in text
    data = json.loads(call("compare", one, two, "--json").output)
    assert data["schema"] == "pmabench.comparison/1"
    first = next(d for d in data["differences"] if d["symbol"] == "K")
    assert (first["difference"], first["half_width"]) == (pytest.approx(60.0), pytest.approx(800**0.5))
    assert first["E_n"] == pytest.approx(60 / 800**0.5)
    assert (data["a"]["runs"], data["b"]["simulated"]) == (["r1"], True)


SENSORS = """schema: pmabench.map/1
name: study
source: my lab
kind: isometric
recorded: 2026-11-20
file: {delimiter: comma, header: first line}
columns:
  t: {is: time, unit: s}
  p: {is: pressure, unit: kPa, expanded_uncertainty: 1 kPa, gain_uncertainty: 0.5 %}
  f: {is: force, unit: N, expanded_uncertainty: 1 N, gain_uncertainty: 1 %}
sampling: {rate: [10 Hz, 2000 Hz], gap: 1 s}
trials: {by: file, point: {contraction: 0 mm}}
specimen: {type: muscle, serial: "1", nominal_length: 300 mm}
"""


def imported(folder, name, seeds, sensors=SENSORS):
    """Two tests by a map, processed."""
    (folder / f"{name}.yaml").write_text(sensors)
    files = [folder / f"{seed}.csv" for seed in seeds]
    for seed, path in zip(seeds, files, strict=True):
        t, noise = np.arange(0.0, 40.0, 0.02), np.random.default_rng(seed).standard_normal((2, 2000))
        P = 500.0 - 22.0 * np.abs(t - 20.0)
        table = np.column_stack([t, P + 0.1 * noise[0], 0.9 * P - 20.0 + 0.3 * noise[1]])
        np.savetxt(path, table, delimiter=",", header="t,p,f", comments="", fmt="%.8g")
    out = folder / name / "".join(map(str, seeds))
    reported = call("import", *files, "--map", folder / f"{name}.yaml", "--out", out / "runs", "--json").stdout
    call("process", *(entry["run"] for entry in json.loads(reported)["runs"]), "--out", out / "analysis")
    return out / "analysis" / "isometric"


def test_imports_by_one_map_share_the_scales_of_its_sensors(tmp_path):
    """A gain of 0.5 % and of 1 % on both sides let K +0.5 % pass. Of a day that nobody gave no zero is shared."""
    one, two = (imported(tmp_path, "map", seeds) for seeds in ((1, 2), (3, 4)))
    others = imported(tmp_path, "other", (5, 6), SENSORS.replace("gain_uncertainty: 1 %", "gain_uncertainty: 1.1 %"))
    undated = [
        imported(tmp_path, "undated", seeds, SENSORS.replace("recorded: 2026-11-20\n", ""))
        for seeds in ((7, 8), (9, 10))
    ]

    def slope(b, a=one):
        data = json.loads(call("compare", a, b, "--json").output)
        return next(d for d in data["differences"] if d["symbol"] == "m")

    scale = 0.01 * slope(two)["b"]["value"]
    assert slope(two)["half_width"] < 0.2 * scale
    assert slope(others)["half_width"] > 1.4 * scale
    assert slope(undated[1], undated[0])["half_width"] > 1.4 * scale, "their zeros may be of two days"


def test_a_folder_is_found_by_the_short_path_that_process_prints(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kind = "contraction-relaxation"
    for name, K in (("20261130-0720_M_013a", 6060.0), ("20261130-0721_M_0cd4", 6000.0)):
        made = Analysis(kind, (name,), False, tuple(estimates((K, 7000.0, 8000.0), (160.0, 270.0, 380.0))))
        write_analysis(made, tmp_path / "analyses" / name / kind)
    assert "furthest apart at 200 kPa: +0.06 N/mm" in call("compare", "analyses/013a", "0cd4").output
    assert "there is no such folder" in call("compare", "analyses/0000", "0cd4", code=3).output


def test_beyond_the_limit_is_exit_6(folders):
    reported = call("compare", *folders, "--accept", "E_n<=1", "-q", code=6).output
    assert reported == "NOT ACCEPTED: K at 200 kPa: E_n +2.12, accepted 1\n"
    call("compare", *folders, "--accept", "E_n <= 3", "--accept", "difference<=1.5 %")
    call("compare", *folders, "--accept", "difference <= 0.5 %", code=6)


def test_a_published_table_is_the_reference(folders, tmp_path):
    table = tmp_path / "lines.csv"
    table.write_text("# somebody 2009\npressure [bar],K [N/mm]\n2,6.06\n3.5,7.4\n9,9\n")
    data = json.loads(call("compare", folders[0], f"{table}:Somebody 2009", "--json").output)
    reported = {d["at"]["pressure"]: d for d in data["differences"]}
    assert reported[2e5]["difference"] == pytest.approx(0.0)
    assert reported[3.5e5]["difference"] == pytest.approx((7000 + 8008) / 2 - 7400)
    assert reported[3.5e5]["between_points"] == "a"
    assert data["b"]["name"] == "Somebody 2009"
    assert any("K has no value in A at 900 kPa" in f["text"] for f in data["findings"])


def test_a_catalogue_of_forces_is_compared_with_curves(tmp_path):
    trace = Trace(
        "i", "isometric", "10 mm", {"pressure": np.array([0.0, 2e5, 4e5]), "force": np.array([0.0, 200.0, 400.0])},
        {"pressure": "pressure", "force": "force"}, {"contraction": 0.01},
    )  # fmt: skip
    folder = write_analysis(Analysis("isometric-pressurisation", ("r1",), False, tuple(estimates((1.0, 2.0, 3.0), (1, 2, 3))),
                                     traces=(trace,)), tmp_path / "a")  # fmt: skip
    table = tmp_path / "catalogue.csv"
    table.write_text("pressure [bar],contraction [mm],force [N]\n1,10,110\n3,10,270\n")
    (curve,) = json.loads(call("compare", folder, table, "--json").output)["curves"]
    assert curve["size"] == pytest.approx((10 / 110 + 30 / 270) / 2)
    reported = call("compare", folder, table, "--accept", "difference<=5 %", code=6).output
    assert "NOT ACCEPTED: force over pressure at contraction 10 mm: mean size 10 %, accepted 5 %" in reported
    call("compare", folder, table, "--accept", "difference<=12 %")
    assert "curves have no E_n" in call("compare", folder, table, "--accept", "E_n<=1", code=2).output


def test_the_page_shows_both_and_nothing_on_it_is_active(folders, tmp_path):
    table = tmp_path / "lines.csv"
    table.write_text(f"# {EVIL}\npressure [bar],K [N/mm]\n2,6.06\n3.5,7.4\n")
    page = tmp_path / "c.html"
    assert call("compare", folders[0], f"{table}:{EVIL}", "-o", page).output.rstrip().endswith(str(page))
    text = page.read_text()
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert "\x1b" not in text
    assert text.count("<svg") == 1
    again = tmp_path / "d.html"
    call("compare", folders[0], f"{table}:{EVIL}", "-o", again)
    assert again.read_text() == text


def test_names_from_a_file_that_anybody_wrote_are_harmless(tmp_path):
    odd = Estimate(EVIL, 1.0, EVIL, EVIL, EVIL, {EVIL: 2.0, "pressure": 3e5}, Parts(0.1), 4, coordinate=EVIL)
    at = [replace(odd, at={EVIL: 2.0, "pressure": P}, value=P) for P in (2e5, 3e5)]
    folders = [
        write_analysis(Analysis(EVIL, (name,), False, tuple(at)), tmp_path / name / "odd") for name in ("one", "two")
    ]
    page = tmp_path / "c.html"
    result = call("compare", *folders, "-o", page, "--accept", "difference<=1 %")
    assert "\x1b" not in result.output + page.read_text()
    assert "<script" not in page.read_text()


@pytest.mark.parametrize(
    ("more", "code", "reported"),
    [
        ([], 2, "give B, or --method twice"),
        (["nowhere"], 3, "there is no such folder"),
        (["--method", "measured-pressure", "--method", "guess"], 2, 'has no method "guess"; it has measured-pressure'),
        (["BOTH", "--accept", "E_n>=1"], 2, 'expected "E_n<=1"'),
        (["BOTH", "--accept", "E_n<=1 %"], 2, "E_n has no unit"),
        (["BOTH", "--accept", "difference<=2"], 2, "no ratio with a unit"),
        (["BOTH", "--accept", "E_n<=nan"], 2, "above 0"),
        (["BOTH", "--at", "3 mm"], 2, "no unit of pressure"),
    ],
)
def test_what_cannot_be_compared_is_a_sentence(folders, more, code, reported):
    words = [str(folders[1]) if word == "BOTH" else word for word in more]
    assert reported in call("compare", folders[0], *words, code=code).output


def test_a_table_is_no_first_side_and_a_folder_without_analyses_none(folders, tmp_path):
    table = tmp_path / "lines.csv"
    table.write_text("pressure [bar],K [N/mm]\n2,6.06\n")
    assert "it can only be B" in call("compare", table, folders[0], code=2).output
    (tmp_path / "empty").mkdir()
    assert "holds no analysis" in call("compare", folders[0], tmp_path / "empty", code=3).output
    table.write_text("pressure [bar],B_c [N.s/mm]\n2,6.06\n")
    assert "matches no figure" in call("compare", folders[0], table, code=3).output


def test_whether_both_agree_is_the_first_sentence(folders, tmp_path):
    one, two = folders
    page = tmp_path / "c.html"
    (first, *_) = json.loads(call("compare", one, two, "--json").output)["findings"]
    assert first["text"].startswith("1 of 6 differences are larger than their 95 % interval")
    same = write_analysis(Analysis("contraction-relaxation", ("r3",), False, tuple(estimates((6e3, 7e3, 8e3), (160, 270, 380)))),
                          tmp_path / "three")  # fmt: skip
    (first, *_) = json.loads(call("compare", same, two, "--json", "-o", page).output)["findings"]
    assert first["text"].startswith("A and B agree: 0 of 6 differences")
    text = page.read_text()
    assert text.count("filled: side A, open: side B, a little aside") == 2
    assert text.index("A and B agree") < text.index(": agree at all 3 points")
