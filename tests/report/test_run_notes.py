"""The report prints what was noted of a run, with its pictures, and nothing of it can act."""

import base64
import json
from dataclasses import replace

from pmabench.report.document.deviations import deviations
from pmabench.store.notes import add_note
from pmabench.store.reader import open_run
from tests.report.samples import render
from tests.report.test_html import EVIL, Page
from tests.store.runs import begin, closed, die, record

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


def page(folder):
    return Page(render([], [open_run(folder)]))


def test_notes_exclusions_and_pictures_are_printed(tmp_path):
    folder = closed(tmp_path)
    for name, raw in (("rig.png", PNG), ("trace.pdf", b"%PDF-1.4"), ("fake.jpg", b"<svg onload=alert(1)>")):
        (tmp_path / name).write_bytes(raw)
    add_note(folder, "hose replaced", attach=[tmp_path / "rig.png", tmp_path / "trace.pdf"], operator="A. Meyer")
    add_note(folder, exclude=0, because="the table was hit", attach=[tmp_path / "fake.jpg"], operator="B. Ito")
    read = page(folder)
    assert "A. Meyer: hose replaced (attached: trace.pdf)" in read.text
    assert "B. Ito: Trial 1 is left out: the table was hit (attached: fake.jpg)" in read.text
    (image,) = [attributes for tag, attributes in read.tags if tag == "img"]
    assert base64.b64decode(image["src"].removeprefix("data:image/png;base64,")) == PNG
    assert image["alt"] == "rig.png"


def test_a_page_without_notes_has_no_heading_for_them(tmp_path):
    assert "Notes taken afterwards" not in page(closed(tmp_path)).text


def test_hostile_notes_are_inert(tmp_path):
    folder = closed(tmp_path)
    add_note(folder, EVIL, exclude=1, because=EVIL, operator=EVIL)
    read = page(folder)
    assert not any(tag in ("img", "iframe") for tag, _ in read.tags)
    assert [tag for tag, _ in read.tags].count("script") == 3
    assert "alert(1)" in read.text


def test_a_guards_vent_and_interpolated_channels_are_remarked(tmp_path):
    writer = begin(tmp_path)
    record(writer)
    die(writer)
    about = {"vent": {"result": "confirmed", "actions": []}, "cause": "the engine died", "t": 1.0}
    (writer.folder / "guard.json").write_text(json.dumps(about))
    run = replace(open_run(writer.folder), interpolated={"pressure": "interpolated from the stream valve (100 Hz)"})
    said = deviations([run], {run.id: "R1"})
    assert "R1: the program died; the guard vented the bench after that: confirmed" in said
    assert "R1: pressure: interpolated from the stream valve (100 Hz)" in said
