"""A run that is killed and gone on with until it is done has each trial exactly once, in order (R7)."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.cli.prepare import prepare
from pmabench.engine.resume import continue_run
from pmabench.store.chain import open_chain
from tests.engine.killed_resume import KINDS, SETTINGS
from tests.reliability.cases import cases

ROOT = Path(__file__).resolve().parents[2]
KILLS = 6
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def chains(tmp_path_factory):
    return killed(tmp_path_factory.mktemp("killed"), cases(KILLS), "contraction-relaxation")


def killed(folder, kills, kind):
    command = [sys.executable, "-m", "tests.engine.killed_resume", str(folder / "runs"), str(kills), "7", kind]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_each_trial_is_finished_once_and_in_order(chains, record_property):
    record_property("cases", chains["kills"])
    assert chains["kills"] >= KILLS
    for reported in chains["chains"]:
        assert reported["end"][0] == 0, reported["end"]
        chain = open_chain(Path(reported["last"]))
        end = "interrupted" if reported["killed_at_the_end"] else "finished"
        assert [run.status for run in chain] == ["interrupted"] * (len(chain) - 1) + [end]
        finished = [trial.index for run in chain for trial in run.trials if trial.status == "finished"]
        assert finished == list(range(20)), f"{len(chain)} runs: {finished}"
        assert len({json.dumps(run.manifest["snapshots"]["plan.json"]) for run in chain}) == 1
        names = {name for run in chain for name in run.manifest["snapshots"] if name.startswith("calibrations/")}
        assert names
        for name in names:
            assert len({run.manifest["snapshots"][name] for run in chain}) == 1, f"{name} is mixed"


@pytest.mark.study  # on demand: `make reliability PART=resume`
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "contraction-relaxation"])
def test_each_trial_of_other_kinds_is_finished_once_and_in_order(kind, tmp_path):
    reported = killed(tmp_path, 4, kind)
    assert reported["kills"] >= 4
    trials = len(prepare(kind, *KINDS[kind]).plan.trials)
    for one in reported["chains"]:
        assert one["end"][0] == 0, one["end"]
        chain = open_chain(Path(one["last"]))
        finished = [trial.index for run in chain for trial in run.trials if trial.status == "finished"]
        assert finished == list(range(trials)), f"{len(chain)} runs: {finished}, {one['end']}"


def test_the_kills_lie_everywhere(chains):
    counts = [len(open_chain(Path(reported["last"]))) for reported in chains["chains"]]
    whole = sum(not reported["killed_at_the_end"] for reported in chains["chains"])
    assert sum(counts) - whole == chains["kills"]
    assert max(counts) > 2


def test_what_has_changed_is_refused_by_name_and_can_be_accepted(chains, tmp_path):
    """On the first run of a chain, which was closed as interrupted, without those that go on after it."""
    there = Path(open_chain(Path(chains["chains"][0]["last"]))[0].path)
    first = Path(shutil.copytree(there, tmp_path / there.name))
    made = prepare("contraction-relaxation", "mock", "mas-20-250-paper0", SETTINGS)
    name = next(name for name in made.mounted.documents if name.startswith("calibrations/"))
    for kind, document in (("calibration", name), ("bench", "bench.yaml"), ("specimen", "specimen.yaml")):
        documents = {**made.mounted.documents, document: made.mounted.documents[document] + "# changed\n"}
        mounted = replace(made.mounted, documents=documents)
        with pytest.raises(InvalidFile, match=f"the {kind} is not what it was"):
            continue_run(first, made.plan, mounted, made.protocol_text)
        assert continue_run(first, made.plan, mounted, made.protocol_text, (kind,)).steps
    with pytest.raises(InvalidFile, match="the protocol is not what it was"):
        continue_run(first, made.plan, made.mounted, made.protocol_text + "# changed\n")


def test_a_run_that_another_one_goes_on_after_is_not_gone_on_with_again(chains):
    """Its trials would be done twice; the run to go on after is named, whichever of the chain is given."""
    long = max((open_chain(Path(reported["last"])) for reported in chains["chains"]), key=len)
    made = prepare("contraction-relaxation", "mock", "mas-20-250-paper0", SETTINGS)
    for run in long[:-1]:
        with pytest.raises(InvalidFile, match="done twice") as refused:
            continue_run(Path(run.path), made.plan, made.mounted, made.protocol_text)
        assert f"pmabench run --resume {long[-1].path}" in str(refused.value)


def test_a_run_that_is_done_is_not_gone_on_with(chains):
    made = prepare("contraction-relaxation", "mock", "mas-20-250-paper0", SETTINGS)
    with pytest.raises(InvalidFile, match="nothing is left to do"):
        continue_run(Path(chains["chains"][0]["last"]), made.plan, made.mounted, made.protocol_text)
