"""Damaged files, thousands of each format: refused in a sentence or taken, and no changed number is taken in silence.

What is told of a number that damage changed: its row is flagged, or a new doubt or fault names its channel or the file.
Without either it may differ only by what the map and the channel leave open: it lies within the range of its thirty
neighbours on either side, widened by the limit of spikes and, but for a command, by that range; its time lies between
those of its neighbours (`gap`) or within the rate that the map allows.
"""

import random
import resource
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.files.document import read_document
from pmabench.store import spikes
from pmabench.store.importers import apart
from pmabench.store.importers.apart import CPU
from pmabench.store.importers.guess.write import map_text
from pmabench.store.importers.prepare import prepare
from tests.importing import guess_files, read_map
from tests.reliability.cases import cases

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"
STEP = OLD / "polled" / "2026-01-05_101500_step_exp" / "step_data.dat"
SOURCES = {
    "text": (STEP, "step.yaml"),
    "lvm": (OLD / "foreign" / "one.lvm", "lvm.yaml"),
    "lvm-comma": (OLD / "foreign" / "comma.lvm", "lvm.yaml"),
    "tdms": (OLD / "foreign" / "bench.tdms", "tdms.yaml"),
    "mat5": (OLD / "foreign" / "log5.mat", "mat.yaml"),
    "mat73": (OLD / "foreign" / "log73.mat", "mat.yaml"),
}
SIGNS = [b",", b"\t", b"\n", b".", b"-", b"e", b"9", b"0", b"1", b"5", b" ", b"nan", b"\0", b"\xff", b";"]


def mutated(content, rng):
    """One to three places changed, cut out, put in or doubled; sometimes the end is missing."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 3)):
        at, kind = rng.randrange(len(data)), rng.randrange(9)
        if kind > 5:  # a digit of a number where there is one, else a byte
            data[at] = rng.choice(b"0123456789") if data[at : at + 1].isdigit() else rng.randrange(256)
        elif kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at : at + 1] = rng.choice(SIGNS)
        elif kind == 2:
            del data[at : at + rng.choice((1, 1, 2, 8, 40))]
        elif kind == 3:
            data[at:at] = rng.choice(SIGNS)
        elif kind == 4:
            data[at : at + 8] = rng.randbytes(8)
        else:
            length = rng.choice((8, 60))
            data[at:at] = data[at : at + length]
    return bytes(data[: rng.randrange(len(data))] if rng.random() < 0.05 else data)


def aligned(t, whole):
    """For each row of the damaged file the row of the whole file with the next time stamp."""
    right = np.searchsorted(whole, t).clip(1, len(whole) - 1)
    return right - (t - whole[right - 1] < whole[right] - t)


def silent(found, whole, rules):
    """What is wrong in the damaged file and not told; empty where all is told."""
    reported = {(f.kind, f.channel) for f in found.findings if f.level != "note"}
    new = reported - {(f.kind, f.channel) for f in whole.findings if f.level != "note"}
    if any(not channel for _, channel in new):
        return []
    wrong = []
    good = found.flags == 0
    counted = len(found.t) == len(whole.t)
    row = np.arange(len(found.t)) if counted else aligned(found.t, whole.t)
    if counted:
        late = np.abs(found.t - whole.t) > rules.file.sampling.gap + np.abs(whole.t) * (
            rules.file.sampling.rate[1] / rules.file.sampling.rate[0] - 1.0
        )
        if (late & good).any():
            wrong.append("time")
    for channel, before in zip(found.checked, whole.checked, strict=True):
        name = channel.rule.role
        if any(each == name for _, each in new):
            continue
        apart = spikes.beyond_neighbours(before.si, swings=not name.endswith("command"))
        limit = spikes.spike_limit(before.si, apart)
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(before.si, 30, mode="edge"), 61)
        low, high = windows.min(axis=1)[row], windows.max(axis=1)[row]
        room = limit + (0.0 if name.endswith("command") else high - low)
        if (good & ((channel.si > high + room) | (channel.si < low - room))).any():
            wrong.append(name)
    return wrong


@pytest.mark.timeout(1800)  # on demand there are 10,000 cases of each
@pytest.mark.parametrize("name", SOURCES)
def test_damaged_files_are_refused_or_what_they_changed_is_reported(tmp_path, name, record_property):
    count = cases(50)
    source, map_name = SOURCES[name]
    rules, content = read_map(OLD / map_name), source.read_bytes()
    path = tmp_path / source.parent.name / source.name
    path.parent.mkdir()
    whole = prepare(source, rules)
    rng = random.Random(f"{name} {count}")
    outcome: Counter[str] = Counter()
    wrong, longest = [], 0.0
    for number in range(count):
        data = mutated(content, rng)
        path.write_bytes(data)
        begin = time.perf_counter()
        try:
            found = prepare(path, rules)
        except InvalidFile as refused:
            assert refused.problems
            assert all(problem.message.isprintable() for problem in refused.problems), refused
            ended = any("its reader end" in p.message or "s of CPU" in p.message for p in refused.problems)
            outcome["reader ended" if ended else "refused"] += 1
        else:
            outcome["taken"] += 1
            if why := silent(found, whole, rules):
                wrong.append((number, why))
                (tmp_path / f"silent-{number}").write_bytes(data)
        longest = max(longest, time.perf_counter() - begin)
    record_property("cases", count)
    record_property("failures", len(wrong))
    print(name, dict(outcome), f"longest {longest:.2f} s", wrong[:20])
    assert not wrong, f"{len(wrong)} of {count}: {wrong[:10]}; {tmp_path}"
    assert outcome["refused"]


def test_the_judge_sees_a_number_that_was_changed_in_silence(tmp_path):
    """A reader that believed a damaged number would be found: here the flags are taken away."""
    rules = read_map(OLD / "lvm.yaml")
    source = OLD / "foreign" / "one.lvm"
    text = source.read_bytes().replace(b"\t239.340000\t", b"\t539.340000\t", 1)
    (tmp_path / "one.lvm").write_bytes(text)
    whole, found = prepare(source, rules), prepare(tmp_path / "one.lvm", rules)
    assert not silent(found, whole, rules)
    found.flags[:] = 0
    kept = tuple(f for f in found.findings if f.kind != "spike")
    blind = type(found)(**{**vars(found), "findings": kept})
    assert silent(blind, whole, rules) == ["force"]


def test_the_seconds_and_bytes_of_a_reader_are_limited_by_the_system():
    content = (OLD / "foreign" / "one.lvm").read_bytes()
    question = {"layout": {"format": "lvm"}, "wanted": None, "optional": [], "ignored": []}
    list(apart.read_apart("lvm", "old", [content], question))
    limits = Path(f"/proc/{apart._children['lvm'].process.pid}/limits")
    if limits.exists():
        line = next(line for line in limits.read_text().splitlines() if line.startswith("Max address space"))
        assert int(line.split()[3]) == 2_000_000_000
    assert resource.RLIMIT_AS
    assert CPU == 2.0


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", ["text", "lvm", "tdms", "mat73"])
def test_a_damaged_file_is_guessed_or_refused_and_its_map_is_yaml(tmp_path, name, record_property):
    count = min(cases(10), 1000)
    content = SOURCES[name][0].read_bytes()
    path = tmp_path / SOURCES[name][0].name
    rng = random.Random(f"guess {name}")
    for _ in range(count):
        path.write_bytes(mutated(content, rng))
        try:
            text = map_text(guess_files([path]))
        except InvalidFile as refused:
            assert refused.problems
            continue
        (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
        assert read_document(tmp_path / "map.yaml").data["schema"] == "pmabench.map/1"
    record_property("cases", count)
