"""A run that continues another: trials once each over the chain, links that do not fit are refused (R7)."""

import json
import shutil

import pytest

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.cli.sources import load_runs
from pmabench.store.catalogue import catalogue
from pmabench.store.chain import continued, finished_trials, open_chain, open_chains
from pmabench.store.folder import open_json, sealed_json, sha256_of
from pmabench.store.notes import add_note
from pmabench.store.reader import open_run
from pmabench.store.verify import verify
from tests.cli.test_cli import call
from tests.store.runs import RATE, begin, block, die


def write(parent, name, trials, before=None, end="finished", **manifest):
    """A run of one second per trial; `trials` are (index, status), the status None: it dies in that trial."""
    link = {"continues": before} if before else {}
    writer = begin(parent, name, **link, **manifest)
    rows = 0
    for number, entry in enumerate(trials):
        index, status, *attempt = entry
        point = {"pressure": 1e5 * (1 + index)}
        reported = {"attempt": attempt[0]} if attempt else {}
        writer.event("trial-begin", number, trial=index, point=point, repeat=0, reference=False, **reported)
        writer.append("daq", *block(rows, int(RATE)))
        rows += int(RATE)
        if status is None:
            die(writer)
            forget_writer(writer.folder)
            return writer.folder
        writer.event("trial-end", number + 1 - 1 / RATE, trial=index, status=status)
    return writer.close(end)


def forget_writer(folder):
    """The process that wrote it counts as dead."""
    path = folder / "manifest.json"
    data = open_json(path.read_bytes(), path)
    del data["sha256"]
    path.write_bytes(sealed_json(data | {"writer": {}}))


def reported(runs):
    return [[(trial.index, trial.status) for trial in run.trials] for run in runs]


@pytest.fixture
def three(tmp_path):
    """A run that died in trial 2, one that goes on and is aborted in trial 4, one that ends."""
    first = write(tmp_path, "one", [(0, "finished"), (1, "finished"), (2, None)])
    second = write(tmp_path, "two", [(2, "finished"), (3, "finished"), (4, "interrupted")], continued(first), "aborted")
    third = write(tmp_path, "three", [(4, "finished"), (5, "finished")], continued(second))
    return [first, second, third]


def test_a_chain_has_every_trial_once(three):
    runs = open_chain(three[2])
    assert reported(runs) == [
        [(0, "finished"), (1, "finished"), (2, "interrupted")],
        [(2, "finished"), (3, "finished"), (4, "interrupted")],
        [(4, "finished"), (5, "finished")],
    ]
    assert finished_trials(three[2]) == [0, 1, 2, 3, 4, 5]
    assert finished_trials(three[1]) == [0, 1, 2, 3]
    assert [run.status for run in runs] == ["interrupted", "aborted", "finished"]


def test_continuing_a_dead_run_closes_and_seals_it(tmp_path):
    first = write(tmp_path, "one", [(0, "finished"), (1, None)])
    with (first / "streams" / "daq.arrows").open("ab") as live:
        live.write(b"\xff\xff\xff\xff\x10\x01\x00\x00torn")
    (first / "guard.json").write_text(json.dumps({"vent": {"result": "confirmed", "actions": []}, "cause": "killed"}))
    link = continued(first)
    assert link == {"run": "one", "sha256": sha256_of(first / "seal.json"), "trials_done": [0]}
    assert verify(first) == []
    run = open_run(first)
    assert (run.status, [trial.status for trial in run.trials]) == ("interrupted", ["finished", "interrupted"])
    assert run.manifest["guard"]["vent"]["result"] == "confirmed"
    assert "guard.json" in open_json((first / "seal.json").read_bytes(), "")["files"]
    assert continued(first) == link, "a second time changes nothing"


def test_a_run_that_is_still_recorded_is_not_continued(tmp_path):
    writer = begin(tmp_path)
    with pytest.raises(RecordError, match="still being recorded"):
        continued(writer.folder)
    writer.close("finished")


def test_a_trial_that_was_asked_for_again_is_there_once(tmp_path):
    first = write(tmp_path, "one", [(0, "finished"), (0, "finished", 2), (1, "failed"), (1, "finished", 2), (2, None)])
    assert [(t.index, t.attempt, t.status) for t in open_run(first).trials] == [
        (0, 1, "superseded"),
        (0, 2, "finished"),
        (1, 1, "superseded"),
        (1, 2, "finished"),
        (2, 1, "interrupted"),
    ]
    second = write(tmp_path, "two", [(0, "finished", 3), (2, "finished")], continued(first))
    assert reported(open_chain(second))[0][:2] == [(0, "superseded"), (0, "superseded")]
    assert finished_trials(second) == [1, 0, 2]


def test_an_attempt_that_was_broken_off_takes_nothing_away(tmp_path):
    folder = write(tmp_path, "one", [(0, "finished"), (0, "interrupted", 2)], end="aborted")
    assert [trial.status for trial in open_run(folder).trials] == ["finished", "interrupted"]
    assert finished_trials(folder) == [0]


def test_an_excluded_trial_was_finished_and_is_not_done_again(three):
    add_note(three[0], exclude=1, because="slipped")
    assert finished_trials(three[2]) == [0, 1, 2, 3, 4, 5]
    assert reported(open_chain(three[2]))[0][1] == (1, "excluded")


def test_process_of_the_last_run_takes_the_whole_chain_and_each_run_once(three):
    ids = ["one", "two", "three"]
    assert [run.id for run in load_runs([three[2]])] == ids
    assert [run.id for run in load_runs(three)] == ids
    assert [run.id for run in load_runs(list(reversed(three)))] == ids
    assert [run.id for run in load_runs(three[:1])] == ["one"]


def test_a_renamed_earlier_run_is_found_next_to(three):
    three[0].rename(three[0].with_name("renamed"))
    assert [run.id for run in open_chain(three[2])] == ["one", "two", "three"]


def _missing(runs):
    shutil.rmtree(runs[0])


def _unsealed(runs):
    (runs[1] / "seal.json").unlink()


def _resealed(runs):
    path = runs[0] / "seal.json"
    path.chmod(0o644)
    data = open_json(path.read_bytes(), path)
    del data["sha256"]
    path.write_bytes(sealed_json(data | {"why": "another reason"}))


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (_missing, "continues one, which is not next to it"),
        (_unsealed, "was not closed as it was when three continued it"),
        (_resealed, "was not closed as it was when two continued it"),
    ],
)
def test_a_chain_with_a_missing_or_changed_link_is_refused(three, harm, says):
    harm(three)
    for read in (open_chain, finished_trials):
        with pytest.raises(InvalidFile, match=says) as caught:
            read(three[2])
        assert len(str(caught.value).splitlines()) == 1
        assert caught.value.exit_code == 3


@pytest.mark.parametrize(
    ("change", "manifest", "says"),
    [
        ({"trials_done": [0, 1]}, {}, "these trials were done before: 1, 2; .* finished 1$"),
        ({"trials_done": []}, {}, "these trials were done before: none; .* finished 1$"),
        ({}, {"kind": "static-load"}, "kind is static-load, there contraction-relaxation"),
        ({}, {"simulated": False}, "simulated is False, there True"),
        ({"run": "../one"}, {}, "is not next to it"),
        ({"run": "two"}, {}, "its seal is another one"),
    ],
)
def test_a_run_that_does_not_fit_what_it_continues_is_refused(tmp_path, change, manifest, says):
    first = write(tmp_path, "one", [(0, "finished"), (1, "interrupted")], end="aborted")
    second = write(tmp_path, "two", [(1, "finished")], continued(first) | change, **manifest)
    with pytest.raises(InvalidFile, match=says):
        open_chain(second)


def test_a_trial_at_another_point_is_refused(tmp_path):
    first = write(tmp_path, "one", [(0, "finished"), (1, "interrupted")], end="aborted")
    writer = begin(tmp_path, "two", continues=continued(first))
    writer.event("trial-begin", 0.0, trial=1, point={"pressure": 1.0}, repeat=0, reference=False)
    writer.event("trial-end", 0.1, trial=1, status="finished")
    with pytest.raises(InvalidFile, match="its trial 2 is another one than in the run that it continues"):
        open_chain(writer.close("finished"))


def test_two_runs_that_continue_the_same_one_are_not_counted_together(tmp_path):
    first = write(tmp_path, "one", [(0, "finished"), (1, "interrupted")], end="aborted")
    link = continued(first)
    forks = [write(tmp_path, name, [(1, "finished")], link) for name in ("two", "three")]
    with pytest.raises(InvalidFile, match="both continue one: give one of the two"):
        open_chains(forks)
    assert [run.id for run in open_chains([first, forks[1]])] == ["one", "three"]


@pytest.mark.parametrize("link", ["one", {"run": "one"}, 7, []])
def test_a_link_that_says_nothing_is_refused(tmp_path, link):
    folder = write(tmp_path, "two", [(0, "finished")], **{"before": None}, continues=link)
    with pytest.raises(InvalidFile, match="does not say which run it continues"):
        open_chain(folder)


def test_the_list_counts_the_trials_of_the_whole_chain(three):
    rows = {row.id: row for row in catalogue(three[0].parent)}
    assert [(rows[name].trials_before, rows[name].trials_finished) for name in ("one", "two", "three")] == [
        (0, 2),
        (2, 2),
        (4, 2),
    ]
    text = call("runs", "list", three[0].parent).stdout
    assert "6/" in text
    assert "(2 here)" in text
