"""The suite itself: the example driver passes; the command as it is typed; damage is what it says."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from random import Random
from typing import ClassVar

import pytest
from click.testing import CliRunner

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Identity, Truth
from pmabench.cli.main import main
from pmabench.conformance import FAILED, PASSED, rig, run
from pmabench.conformance.relay import KINDS, Hostile
from pmabench.conformance.suite import CHECKS, HOSTILE
from tests.conformance import EXAMPLE_FOLDER as EXAMPLE
from tests.conformance.mutants import EXAMPLE as MUTATED
from tests.conformance.mutants import EXAMPLE_DRIVER as DRIVER
from tests.conformance.mutants import cases, shipped, tried

ENOUGH = 90
"""Kinds of faults of the example driver, so that none gets lost unnoticed."""


@pytest.mark.realtime
def test_the_example_keeps_every_promise():
    results = list(run(tried("example"), hostile=60))
    assert [result.check for result in results] == [*CHECKS, HOSTILE]
    rest = [f"{result.check}: {result.why}" for result in results if result.verdict != PASSED]
    assert rest == ["halt: it stops no motion by itself"]


def test_a_package_of_somebody_else_is_found_by_its_name_when_it_is_installed(tmp_path):
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(tmp_path), str(EXAMPLE)], check=True, timeout=120)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}

    def typed(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "pmabench", "drivers", *arguments],
            env=environment, capture_output=True, text=True, timeout=120, cwd=tmp_path,
        )  # fmt: skip

    listed = {row["name"]: row for row in json.loads(typed("list", "--json").stdout)["drivers"]}
    assert listed["example"]["verified"] == "emulator only"
    assert listed["example"]["can"][:3] == ["samples", "set-points", "ramps and sines"]
    bench = str(EXAMPLE / "bench.yaml")
    done = typed("conformance", "example", "--bench", bench, "--check", "valves", "--check", "imports", "--json")
    reported = json.loads(done.stdout)
    assert (done.returncode, [check["verdict"] for check in reported["checks"]]) == (0, [PASSED, PASSED])


def test_a_truth_file_that_lacks_the_device_is_the_reason_why_nothing_is_tried():
    lacking = replace(tried("example"), wiring=Truth("truths/ours.yaml", {}))
    (result,) = run(lacking, hostile=0, only=["life"])
    assert result.verdict == FAILED
    assert 'truths/ours.yaml: says nothing of the device "controller" of the bench' in result.why


class Elsewhere(import_module(DRIVER.partition(":")[0]).ExampleController):
    """Finds its device by itself: a real one, at which every command arrives."""

    commanded: ClassVar[list] = []

    def open(self):
        return Identity("RegCo", "PR-10", "4711", "1.0")

    def _command(self, *arguments):
        self.commanded.append(arguments)

    write = switch = ramp = sine = arm_watchdog = feed_watchdog = start = _command


@pytest.mark.parametrize("check", ["life", "set-points", "valves", "watchdog"])
def test_a_real_device_that_the_driver_finds_by_itself_is_not_commanded(check):
    """A dump valve was energised and 558 kPa were commanded at a real regulator, and `life` passed."""
    elsewhere = tried("example")
    elsewhere = replace(elsewhere, record=replace(elsewhere.record, driver=f"{__name__}:Elsewhere"))
    (result,) = run(elsewhere, hostile=0, only=[check])
    assert result.verdict == FAILED
    assert "open() reached PR-10 past the emulator" in result.why
    assert Elsewhere.commanded == []


def test_an_error_of_the_emulator_fails_its_check_and_the_others_go_on(monkeypatch):
    def refuse(*_arguments):
        raise DeviceError("controller", "no key was pressed")

    monkeypatch.setattr(rig.Rig, "by_hand", refuse)
    monkeypatch.setattr(rig.Rig, "bring", refuse)
    results = list(run(tried("example"), hostile=0, only=["values", "interface"]))
    assert [result.verdict for result in results] == [FAILED, PASSED]
    assert results[0].why == "the emulator: controller: no key was pressed"


def test_the_exit_code_says_that_a_check_failed():
    bench = str(EXAMPLE / "bench.yaml")
    done = CliRunner().invoke(main, ["drivers", "conformance", "modbus", "--bench", bench])
    assert (done.exit_code, "no device of the driver modbus" in done.stderr) == (2, True)
    done = CliRunner().invoke(main, ["drivers", "conformance", "nothing"])
    assert (done.exit_code, "module:Class" in done.stderr) == (2, True)


def test_who_answers_is_asked_without_a_bench_file():
    from pmabench_drivers.emulator import Emulator

    record = tried("example").record
    emulator = Emulator([replace(record, address="127.0.0.1:0")])
    try:
        address = emulator.devices[record.name].address

        def probed(*more):
            return CliRunner().invoke(main, ["bench", "probe", "--driver", DRIVER, "--address", address, *more])

        reported = json.loads(probed("--option", "rate=100 Hz", "--json").stdout)["devices"]["device"]
        assert (reported["model"], reported["simulated"], reported["verified"]) == (
            "emulated EX-2",
            True,
            "emulator only",
        )
        assert not emulator.log.of("set")
        wrong = probed("--option", "rat=100 Hz")
        assert (wrong.exit_code, 'did you mean "rate"?' in wrong.stderr) == (4, True)
        both = CliRunner().invoke(main, ["bench", "probe", "mock", "--driver", "modbus"])
        assert (both.exit_code, "--driver and --address" in both.stderr) == (2, True)
    finally:
        emulator.close()


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_what_its_name_says(kind):
    chance, data, before = Random(1), b"0123456789", b"abc"
    pieces = [KINDS[kind](data, chance, before) for _ in range(50)]
    whole = [b"".join(piece for _, piece in one) for one in pieces]
    holds = {
        "cut": lambda w: len(w) < 10 and data.startswith(w),
        "bits flipped": lambda w: len(w) == 10,
        "repeated": lambda w: w == data + data,
        "garbage before": lambda w: w.endswith(data) and len(w) > 10,
        "garbage behind": lambda w: w.startswith(data) and len(w) > 10,
        "other bytes": lambda w: len(w) == 10,
        "far too long": lambda w: len(w) > 300,
        "in parts": lambda w: w == data,
        "an older answer": lambda w: w == before,
        "late": lambda w: w == data,
        "nothing": lambda w: w == b"",
    }[kind]
    assert all(holds(w) for w in whole)
    if kind in {"bits flipped", "other bytes"}:
        assert sum(w != data for w in whole) > 45


def test_the_same_seed_is_the_same_damage():
    def some():
        damage = Hostile(Random(7))
        return [(damage.another(), damage(b"0123456789")) for _ in range(100)]

    assert some() == some()


def test_the_table_of_mutants_is_whole():
    assert len(list(cases([MUTATED]))) >= ENOUGH
    assert len({driver for _, driver in cases(shipped())}) == len(shipped())
