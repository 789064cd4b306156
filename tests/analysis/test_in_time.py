"""The order of runs: by when they began, and by the names of files that do not say it; not by how they were given."""

from dataclasses import replace
from itertools import permutations

from pmabench.analysis.imported import in_time
from pmabench.kinds.reduce import reduce_runs
from tests.analysis import judged_forms
from tests.analysis.loop_rig import as_run
from tests.judge import held


def named(run, file, started="2021-07-01T00:00:00.000+00:00"):
    manifest = {
        **run.manifest,
        "started_utc": started,
        "imported": {"file": file, "folder": "f", "started_known": False},
    }
    return replace(run, id=file, manifest=manifest)


def test_files_of_one_time_follow_each_other_by_the_numbers_in_their_names():
    run = as_run("recorded-step", [])
    made = [named(run, file) for file in ("T1.csv", "T2.csv", "T10.csv", "T10b.csv")]
    early = named(run, "Z.csv", "2021-06-30T00:00:00.000+00:00")
    for given in permutations([*made, early]):
        assert [one.id for one in in_time(given)] == ["Z.csv", "T1.csv", "T2.csv", "T10.csv", "T10b.csv"]


def test_a_number_of_any_length_in_a_name_is_compared():
    run = as_run("recorded-step", [])
    long = [named(run, f"T{'9' * count}.csv") for count in (6000, 5000)]
    assert [len(one.id) for one in in_time(long)] == [5005, 6005]


def test_the_order_in_which_runs_are_given_changes_no_value():
    trials = judged_forms.as_trials(held.campaign("cell-drift", 0.3, 5))
    whole = judged_forms.as_run("isometric-pressurisation", trials, held.RATE, {})
    runs = [
        named(replace(whole, trials=(replace(trial, run=f"T{n}.csv"),)), f"T{n}.csv") for n, trial in enumerate(trials)
    ]
    one, other = ([analysis.to_dict() for analysis in reduce_runs(given)] for given in (runs, runs[::-1]))
    assert one[0]["estimates"]
    assert one == other
