"""A law that keeps its command for many samples is given them in blocks: the same record, the same trips."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.cli.prepare import prepare
from pmabench.engine import seek
from pmabench.engine.laws.relay import Relay
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.store.reader import open_run
from pmabench.store.records import Flag

SETTINGS = (
    ("sweep.repeat.count", "1"),
    ("prepare.precondition.cycles", "0"),
    ("trial.relay.periods", "8"),
    ("trial.relay.settle", "1 s"),
)


def recorded(out, **options):
    prepared = prepare("ultimate-gain-relay", "mock-linear", "mas-20-250-paper0", list(SETTINGS))
    bench = prepared.mounted.bench
    devices = tuple(replace(d, options={**d.options, **options}) for d in bench.devices)
    mounted = replace(prepared.mounted, bench=replace(bench, devices=devices))
    outcome = run_plan(prepared.plan, mounted, ConfirmedBeforehand(), out=out)
    return outcome, open_run(outcome.folder)


@pytest.fixture
def counted(monkeypatch):
    """How often the law was asked in each way."""
    ways = {"blocks": 0, "samples": 0}
    for name, way in (("_rarely", "blocks"), ("_always", "samples")):
        real = getattr(seek, name)

        def run(*given, real=real, way=way):
            ways[way] += 1
            return real(*given)

        monkeypatch.setattr(seek, name, run)
    return ways


def test_blocks_and_single_samples_give_the_same_record(tmp_path, monkeypatch, counted):
    _, blocks = recorded(tmp_path / "blocks")
    assert counted["blocks"] > 0
    assert counted["samples"] == 0
    monkeypatch.setattr(Relay, "rarely", False)
    _, single = recorded(tmp_path / "single")
    assert counted["samples"] == counted["blocks"]
    assert len(blocks.trials) == len(single.trials) == 1
    for one, other in zip(blocks.trials, single.trials, strict=True):
        np.testing.assert_array_equal(one.t, other.t)
        slack = np.uint16(Flag.SLACK)  # of a force that noise carries over its threshold
        np.testing.assert_array_equal(one.flags & ~slack, other.flags & ~slack)
        for name, atol in (("pressure_command", 1e-6), ("displacement", 1.1e-6), ("pressure", 50.0), ("force", 0.1)):
            np.testing.assert_allclose(one.channels[name], other.channels[name], rtol=0, atol=atol)


def test_a_limit_that_is_crossed_within_a_block_ends_the_run_at_the_same_sample(tmp_path, monkeypatch, counted):
    fault = {"nan_at": 9.31}
    first, blocks = recorded(tmp_path / "blocks", faults=fault)
    monkeypatch.setattr(Relay, "rarely", False)
    second, single = recorded(tmp_path / "single", faults=fault)
    assert counted == {"blocks": 1, "samples": 1}
    assert first.status == second.status
    assert first.status != "finished"
    assert first.why == second.why
    assert " s is below its limit" in str(first.why)
    assert [trial.t[-1] for trial in blocks.trials] == [trial.t[-1] for trial in single.trials]


def test_a_command_that_is_unchanged_is_sent_once(tmp_path, monkeypatch):
    """A relay sends as many commands as it switches, whichever way it is run."""
    sent = []

    def counting(self, output, value, real=seek.Commander.set):
        sent.append(value)
        return real(self, output, value)

    monkeypatch.setattr(seek.Commander, "set", counting)
    numbers = []
    for rarely in (True, False):
        sent.clear()
        monkeypatch.setattr(Relay, "rarely", rarely)
        _, run = recorded(tmp_path / str(rarely))
        switches = [at for level in run.trials[0].found["ultimate-gain"]["relay"] for at in level["switches"]]
        numbers.append((len(sent), len(switches)))
    assert numbers[0] == numbers[1]
    assert numbers[0][1] <= numbers[0][0] <= numbers[0][1] + 8
