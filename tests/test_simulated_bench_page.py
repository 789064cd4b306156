"""docs/simulated-bench.md against the code: every plant, option, bench and specimen is there, and none that is not."""

import re
from dataclasses import fields
from pathlib import Path

from pmabench_drivers.mock.options import CHOICES, JOINT, PLATFORM, Faults, Options, SensorError, Service

from pmabench.cli.emulate import PRESETS
from pmabench.model.overrides import Overrides
from pmabench.model.presets import PLANTS

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "simulated-bench.md").read_text()
MUSCLES, OPTIONS = PAGE.split("## Options")


def first_cells(text):
    return [name for row in re.findall(r"^\| (.*?) \|", text, re.MULTILINE) for name in re.findall(r"`([^`]+)`", row)]


def test_every_plant_is_reported_and_can_be_chosen():
    reported = ["contractor" + name if name.startswith("-") else name for name in first_cells(MUSCLES)]
    assert set(reported) - {"plant"} == {*PLANTS, JOINT, PLATFORM}
    assert CHOICES["plant"] == (*PLANTS, JOINT, PLATFORM)


def test_the_emulators_take_every_plant_with_a_free_end():
    assert set(PRESETS) == set(PLANTS) - {"daerden"}


def test_every_option_is_reported_once():
    reported = first_cells(OPTIONS)
    known = {item.name for item in (*fields(Options), *fields(Overrides), *fields(Service))}
    assert sorted(reported) == sorted(known - {"overrides", "service", "numbers", "plant", "preset"})


def test_every_fault_and_error_is_reported():
    for item in (*fields(Faults), *fields(SensorError)):
        assert re.search(rf"\b{item.name}\b", OPTIONS), item.name


def test_every_file_that_is_named_is_shipped():
    for bench in re.findall(r"`(mock-?[a-z0-9-]*)`", MUSCLES):
        assert bench == "mock-realtime" or (ROOT / "fixtures" / "benches" / f"{bench}.yaml").is_file(), bench
    for specimen in re.findall(r"\| `([a-z0-9-]+)` \|$", MUSCLES, re.MULTILINE):
        assert (ROOT / "fixtures" / "specimens" / f"{specimen}.yaml").is_file(), specimen
    assert len(re.findall(r"`(mock-[a-z0-9-]+)`", MUSCLES)) > 12
