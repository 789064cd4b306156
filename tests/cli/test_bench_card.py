"""`pmabench bench card`: what hangs at the rig is what the bench file says, in one self-contained file."""

import hashlib
import json
import re
from dataclasses import asdict

import pypdf
import pytest
from click.testing import CliRunner

from pmabench.bench.card import make_card
from pmabench.bench.compile import mount, mount_alone
from pmabench.cli.main import main
from pmabench.report.writing import SMALLEST, letter_size, render_card
from tests.bench.benches import SPECIMEN, rig
from tests.browser import CHROMIUM, NOT_RUN


def card_of(path):
    return asdict(make_card(mount(path, SPECIMEN), "2026-11-21"))


def text_of(html: str) -> str:
    body = html[html.index("<body>") :]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body)).replace("&#39;", "'").replace("\u00a0", " ")


def test_the_card_says_what_the_bench_file_says(tmp_path):
    out = tmp_path / "card.html"
    path = rig(tmp_path)
    result = CliRunner().invoke(main, ["bench", "card", str(path), "--specimen", str(SPECIMEN), "-o", str(out)])
    assert result.exit_code == 0, result.output
    html = out.read_text()
    text = text_of(html)
    for reported in (
        "rig 3", "pmabench vent 'rig 3'", "0 kPa to 600 kPa", "below -30 kPa, above 650 kPa", "vent after 4 ms",
        "above 62.5 mm", "pressure down to 0 kPa at 500 kPa/s", "dump valve opens", "look: pressure is below 20 kPa",
        "filled to 50 kPa, vented, below 20 kPa within 2 s", "falls 60 kPa within 50 ms", "daq · e_stop", "MOCK-P",
        "± 1.5 kPa", "closed while energised, open without power", "0 kPa to 600 kPa = 0 to 6 V", "never above",
        "Not a safety function".lower(), hashlib.sha256(path.read_bytes()).hexdigest()[:16],
    ):  # fmt: skip
        assert reported.lower() in text.lower(), reported
    line = 1 + next(i for i, row in enumerate(path.read_text().splitlines()) if "command: 600 kPa" in row)
    assert f"rig.yaml:{line}:" in text
    assert "SIMULATED" not in text
    assert not re.search(r"(?:src|href)=|url\(|@import|<script", html)
    assert "This bench has" not in text


def test_the_order_of_the_vent_is_that_of_the_file(tmp_path):
    vent = [action for action, _ in card_of(rig(tmp_path))["vent"]]
    assert [text.split()[0] for text in vent] == ["pressure", "wait", "pressure", "dump", "look:"]


def test_what_is_lacking_and_expired_is_on_the_card(tmp_path):
    path = rig(tmp_path, "devices: {daq: {watchdog: null}}\nhands: {at_pressure: 300 kPa}\n")
    file = tmp_path / "calibrations" / "MOCK-P.yaml"
    file.write_text(file.read_text().replace("date: 2026-11-21", "date: 2019-01-01\nvalid_until: 2020-01-01"))
    text = text_of(render_card(card_of(path)))
    for reported in ("NOTHING VENTS", "no watchdog of daq", "expired calibration of pressure", "2020-01-01", "HAZARD"):
        assert reported in text, reported


def test_without_a_specimen_its_limits_are_left_open(tmp_path):
    card = asdict(make_card(mount_alone(rig(tmp_path)), "2026-11-21"))
    assert ["Specimen", "any: its own limits come on top of these"] in card["facts"]
    assert [row[3] for row in card["limits"] if row[0] == "contraction"] == ["above 25 %"]
    assert not re.search(r"\b(?:inf|nan)\b", json.dumps(card))


def test_a_simulated_bench_says_so_and_json_names_the_file(tmp_path):
    out = tmp_path / "card.html"
    result = CliRunner().invoke(main, ["bench", "card", "mock", "-o", str(out), "--json"])
    assert json.loads(result.output) == {"schema": "pmabench.bench-card/1", "path": str(out)}
    assert "SIMULATED" in text_of(out.read_text())


def test_hostile_names_stay_text(tmp_path):
    path = rig(tmp_path, 'name: "<script>alert(1)</script>\'; rm -rf ~"\n')
    html = render_card(card_of(path))
    assert "<script" not in html
    assert "pmabench vent '<script>alert(1)</script>'\"'\"'; rm -rf ~'" in html.replace("&#39;", "'").replace(
        "&lt;", "<"
    ).replace("&gt;", ">").replace("&#34;", '"')


@pytest.mark.parametrize("target", ["/dev/full", "."])
def test_a_card_that_cannot_be_written_is_a_sentence(tmp_path, target):
    result = CliRunner().invoke(main, ["bench", "card", str(rig(tmp_path)), "-o", target])
    assert result.exit_code in {2, 7}
    assert "Traceback" not in result.output


def test_a_wrong_bench_is_reported_with_its_place(tmp_path):
    path = rig(tmp_path, old="trip: 650 kPa, ", new="")
    result = CliRunner().invoke(main, ["bench", "card", str(path), "-o", str(tmp_path / "x.html")])
    assert result.exit_code == 3
    assert "has no trip limit" in result.output
    assert not (tmp_path / "x.html").exists()


def test_a_fuller_card_has_smaller_letters(tmp_path):
    card = card_of(rig(tmp_path))
    sizes = [letter_size({**card, "watch": card["watch"] * n}) for n in (1, 2, 4, 8, 200)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > sizes[2]
    assert sizes[-1] == SMALLEST


@pytest.mark.skipif(CHROMIUM is None, reason=NOT_RUN)
@pytest.mark.parametrize("bench", ["ni", "festo-sine", "mock-realtime-actuator"])
def test_the_fullest_shipped_benches_print_on_one_page(tmp_path, browser, bench):
    out = tmp_path / "card.html"
    assert CliRunner().invoke(main, ["bench", "card", bench, "-o", str(out)]).exit_code == 0
    browser.open(out.as_uri()).pdf(tmp_path / "card.pdf")
    assert len(pypdf.PdfReader(tmp_path / "card.pdf").pages) == 1


def test_the_card_names_only_what_the_bench_has(tmp_path):
    """It said "Press the emergency stop" at a bench without one, and that a relief valve protects where there is none."""
    whole = text_of(render_card(card_of(rig(tmp_path))))
    assert "Press the emergency stop, then shut off the air." in whole
    assert "protected by the relief valve, the normally-open dump valve, the emergency stop, the shield." in whole
    assert "NOT CONFIRMED" not in whole
    bare = "interlocks: []\nair: {relief_valve: none}\nto_confirm: [limits.pressure.trip]\n"
    text = text_of(render_card(card_of(rig(tmp_path, bare))))
    assert "Shut off the air; press the emergency stop if the rig has one." in text
    assert "protected by the normally-open dump valve, the shield." in text
    assert "names NO relief valve and NO emergency stop." in text
    assert "NOT CONFIRMED Values of this bench are still guesses." in text
    assert "Reviewed by nobody" in text
    other = text_of(render_card(card_of(rig(tmp_path, old="name: e-stop", new="name: door"))))
    assert "protected by the relief valve, the normally-open dump valve, the shield." in other
    assert "names NO" not in other, "the contact may be a stop by another name"
