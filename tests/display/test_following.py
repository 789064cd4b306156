"""A folder in any state is read without a fault: torn, not there, ended, dead; and what follows is read on."""

import shutil

import pytest

from pmabench.display.state import RunState
from pmabench.display.view import screen
from pmabench.store.folder import files_of
from tests.display.recorded import LENGTH, RATE, Recorded

POINTS = [(58.86, 3e5), (107.91, 3e5)]


def shown(state, width=80, height=24):
    return "\n".join(line.plain for line in screen(state, width, height))


def everything(state):
    return (
        [(notice.text, notice.level) for notice in state.notices],
        state.lines,
        state.rows,
        state.counts,
        state.status,
    )


def read(folder):
    state = RunState(folder)
    while state.poll():
        pass
    return state


@pytest.fixture
def live(tmp_path):
    """A run that is being written, two trials in."""
    run = Recorded(tmp_path / "runs", POINTS)
    run.load()
    run.trial(0)
    run.trial(1)
    return run


def test_a_torn_tail_is_waited_for(live, tmp_path):
    """Cut at many places, each file is read as far as it is whole, and on from there when the rest has come."""
    whole = read(live.folder)
    assert len(whole.lines) == 2
    for name in ("events.jsonl", "streams/daq.arrows"):
        raw = (live.folder / name).read_bytes()
        for length in range(0, len(raw), max(1, len(raw) // 23)):
            copy = tmp_path / f"{name.replace('/', '-')}-{length}"
            shutil.copytree(live.folder, copy)
            (copy / name).write_bytes(raw[:length])
            state = RunState(copy)
            state.poll()
            assert "running" in shown(state)
            (copy / name).write_bytes(raw)
            while state.poll():
                pass
            assert state.rows == whole.rows
            if name == "events.jsonl":
                assert everything(state) == everything(whole)


def test_a_trial_gets_its_line_from_all_of_its_samples_or_late(live, tmp_path):
    """Events are written before the samples that belong to them."""
    whole = read(live.folder)
    path = live.folder / "streams/daq.arrows"
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) * 7 // 8])
    waiting, late = RunState(live.folder), RunState(live.folder)
    for state in (waiting, late):
        state.poll(now=1e9)
        assert [line.index for line in state.lines] == [0]
    late.poll(now=1e9 + 2.0)
    assert [line.index for line in late.lines] == [0, 1]
    path.write_bytes(raw)
    waiting.poll(now=1e9 + 0.5)
    assert waiting.lines == whole.lines


def test_a_damaged_line_of_the_journal_is_reported_and_nothing_after_it_believed(live):
    path = live.folder / "events.jsonl"
    raw = path.read_bytes()
    at = raw.index(b'"kind":"trial-end"')
    path.write_bytes(raw[:at] + b'"kind":"trial-EnD"' + raw[at + 18 :])
    state = read(live.folder)
    assert not state.lines
    assert any("cannot be read on" in notice.text and notice.level == "fault" for notice in state.notices)


def test_a_run_that_is_not_there_yet(tmp_path):
    state = RunState(tmp_path / "later")
    state.poll()
    assert state.status == "waiting"
    assert "waiting for" in shown(state)
    run = Recorded(tmp_path, POINTS, name="later")
    run.trial(0)
    state.poll()
    assert (state.status, len(state.lines)) == ("running", 1)


def test_files_that_appear_one_by_one(live, tmp_path):
    """Whatever of the folder is there: a picture, and never an exception."""
    copy = tmp_path / "part"
    copy.mkdir()
    for name, path in files_of(live.folder):
        state = RunState(copy)
        state.poll()
        shown(state)
        (copy / name).parent.mkdir(exist_ok=True)
        shutil.copy(path, copy / name)
    assert len(read(copy).lines) == 2


def test_a_damaged_folder_says_so(live):
    (live.folder / "manifest.json").write_bytes(b"{}")
    state = read(live.folder)
    assert "manifest.json" in shown(state, 200)


def test_what_the_end_takes_away_was_read_or_is_read_from_parquet(tmp_path):
    """A display that looks only before and after the end has missed nothing."""
    run = Recorded(tmp_path, POINTS)
    state = RunState(run.folder)
    run.trial(0)
    state.poll()
    run.trial(1)
    run.close()
    while state.poll():
        pass
    assert state.ended
    assert everything(state) == everything(read(run.folder))
    assert state.rows == round(2 * 5.2 * RATE)
    assert (state.status, state.vent) == ("finished", "confirmed")


def test_a_run_whose_writer_died(live, tmp_path, monkeypatch):
    monkeypatch.setattr("pmabench.store.folder._alive", lambda writer: False)
    state = read(live.folder)
    assert state.ended
    assert state.status == "interrupted"
    assert "interrupted" in shown(state)
    assert "the program that wrote it died" in shown(state)


def test_a_run_that_tripped_says_why(live):
    live.writer.event("trip", live.t, reason="pressure 655 kPa above 650 kPa")
    live.close("tripped", "pressure 655 kPa above 650 kPa", vent="failed")
    text = shown(read(live.folder))
    assert "tripped, vent failed" in text
    assert "!! TRIPPED: pressure 655 kPa above 650 kPa" in text


def test_notes_of_others_appear(live):
    from pmabench.store.notes import add_note

    state = read(live.folder)
    add_note(live.folder, "the fitting hisses", operator="N")
    state.poll()
    assert state.notices[-1].text == "note: the fitting hisses"


def test_samples_are_not_kept_for_ever(tmp_path):
    """Of a long run only what the curves and the trial under way need stays in memory."""
    run = Recorded(tmp_path, POINTS * 30)
    state = RunState(run.folder)
    for index in range(60):
        run.trial(index)
        state.poll()
    t, _ = state.samples.trace("pressure")
    assert state.rows == round(60 * 5.2 * RATE)
    assert state.t - t[0] < 140.0


def test_what_the_operators_keys_bring_about_is_shown(live):
    def shown_after(kind, **data):
        live.writer.event(kind, live.t, **data)
        return shown(read(live.folder))

    live.begin(1, repeat=1)
    live.contract(1)
    assert "will repeat this trial" in shown_after("key", key="repeat", on=True)
    assert "will pause, will repeat this trial" in shown_after("key", key="pause", on=True)
    assert "will repeat" not in shown_after("key", key="repeat", on=False)
    live.end(1)
    assert "PAUSED: p goes on" in shown_after("pause", pressure=3e5)
    text = shown_after("goes-on")
    assert "PAUSED" not in text
    held = {"reason": "far from what is commanded", "limit": "following pressure"}
    assert "HELD by following pressure" in shown_after("warning", action="hold", **held)
    assert "HELD" not in shown_after("warning", action="over", **held)
    assert "will" not in text


@pytest.mark.parametrize(
    ("kind", "data", "sign", "words"),
    [
        ("load-check", {"ok": False, "text": "the load cell reads 70 N"}, "!", "load-check: the load cell reads 70 N"),
        ("load-check", {"ok": True, "text": "the load cell reads 59 N"}, " ", "load-check: the load cell reads 59 N"),
        ("warning", {"reason": "force 1700 N above 1600 N", "value": 1.0}, "!", "warning: force 1700 N above 1600 N"),
        (
            "warning",
            {"reason": "force is high", "action": "hold"},
            "!",
            "held, nothing new is commanded: force is high",
        ),
        ("warning", {"reason": "force is inside again", "action": "over"}, " ", "force is inside again"),
        ("vent", {"result": "commanded"}, "!!", "vent commanded"),
        ("vent", {"result": "confirmed"}, " ", "vent confirmed"),
        ("ended-early", {"reason": "Traceback:\n  File x\nValueError: it"}, "!!", "ended early: ValueError: it"),
        ("new-kind", {"a": 1.23456789, "b": None}, " ", "new-kind: a 1.235, b None"),
    ],
)
def test_events_are_reported_with_a_sign(live, kind, data, sign, words):
    live.writer.event(kind, 61.0, **data)
    line = shown(read(live.folder)).splitlines()[-1]
    assert line.rstrip() == f"   1:01 {sign:<2} {words}"


def test_while_nothing_is_recorded_the_newest_values_are_shown(tmp_path):
    """As in the warm-up of a session: 300 kPa are commanded, and the last recorded sample is old."""
    run = Recorded(tmp_path / "runs", POINTS)
    run.trial(0)
    run.writer.event(
        "command", run.t, output="pressure", type="set", value=3e5, before=0.0, phase="warm-up", trial=None
    )
    run.writer.event("live", run.t + 1.0, values={"pressure": 298.7e3, "displacement": 0.0312})
    state = read(run.folder)
    assert state.channels["pressure"].value == 298.7e3
    assert "298.7 kPa" in shown(state)
    assert not any("live" in notice.text for notice in state.notices)
    run.begin(1)
    run.contract(1, until=-0.1)
    assert read(run.folder).channels["pressure"].value == 0.0, "in a trial its samples are shown"


def test_a_run_that_goes_on_shows_what_the_chain_has(tmp_path):
    run = Recorded(
        tmp_path / "runs", POINTS, continues={"run": "one", "sha256": "", "trials_done": [0]}, trials_planned=2
    )
    state = read(run.folder)
    assert state.done == 1
    assert "1 of 2 trials done (1 before this run)" in shown(state)
    hands = 3.0  # before the first trial, and so behind the run
    assert state.progress.done(0.0) == pytest.approx((hands + LENGTH) / (hands + 2 * LENGTH))
    run.trial(1)
    assert read(run.folder).done == 2
