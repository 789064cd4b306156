"""Bugs to seed, as data: each is a text of one file, what it becomes, and the tests that must fail then."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bug:
    """A slip that somebody could make; `old` stands exactly once in `file`."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


BUGS = (
    Bug(
        "samples and events are never synced",
        "pmabench/store/folder.py",
        '(os.fdatasync if sys.platform == "linux" else os.fsync)(self._fd)',
        "pass",
        ("tests/reliability/test_disk_faults.py", "tests/reliability/test_power_cut.py"),
    ),
    Bug(
        "a folder that cannot be listed is sealed as an empty one",
        "pmabench/store/folder.py",
        "os.walk(folder, onerror=fail)",
        "os.walk(folder)",
        ("tests/store/test_writer.py",),
    ),
    Bug(
        "a dead run counts as finished",
        "pmabench/store/folder.py",
        'else "interrupted"\n\n\ndef this_process',
        'else "finished"\n\n\ndef this_process',
        ("tests/store/test_killed.py",),
    ),
    Bug(
        "the checksum of a batch is not looked at",
        "pmabench/store/livestream.py",
        'whole = notes[b"crc32"] == b"%08x" % crc',
        "whole = True",
        ("tests/store/test_damage.py",),
    ),
    Bug(
        "a changed file of a closed run is read all the same",
        "pmabench/store/reader.py",
        "if expected and hashlib.sha256(raw).hexdigest() != expected:",
        "if expected and not raw:",
        ("tests/store/test_damage.py",),
    ),
    Bug(
        "a failed sync in the background is forgotten",
        "pmabench/store/writer.py",
        "self._finish_streams() or (None if self._told else self._failure)",
        "self._finish_streams()",
        ("tests/store/test_writer.py",),
    ),
    Bug(
        "a hole between two streams carries no flag",
        "pmabench/store/timebase.py",
        "np.uint16(Flag.GAP)).astype(np.uint16)",
        "np.uint16(0)).astype(np.uint16)",
        ("tests/store/test_timebase.py",),
    ),
    Bug(
        "a hole between two streams is bridged",
        "pmabench/store/timebase.py",
        "width <= REACH * period",
        "width <= 100 * REACH * period",
        ("tests/store/test_timebase.py",),
    ),
    Bug(
        "drift with the wrong sign",
        "pmabench/store/records.py",
        "(1.0 + self.drift)",
        "(1.0 - self.drift)",
        ("tests/store/test_clocks.py",),
    ),
    Bug(
        "the first attempt stands instead of the last",
        "pmabench/store/trials.py",
        "number != last[trial.index]",
        "number == last[trial.index] and trial.attempt > 1",
        ("tests/store/test_chain.py",),
    ),
    Bug(
        "a run continues a run that was changed since",
        "pmabench/store/chain.py",
        "or sha256_of(folder / files.SEAL) != digest:",
        'or digest == "":',
        ("tests/store/test_chain.py",),
    ),
    Bug(
        "notes are no chain",
        "pmabench/store/notes.py",
        'if note.number != number or content.get("before") != last:',
        "if note.number != number:",
        ("tests/store/test_notes.py",),
    ),
    Bug(
        "a command that is no number passes",
        "pmabench/guard/limits.py",
        "        if not isfinite(value):\n",
        '        if value in (float("inf"), -float("inf")):\n',
        ("tests/guard/test_guard.py",),
    ),
    Bug(
        "a value is rounded away from the safe side",
        "pmabench/guard/limits.py",
        "upwards = lower_si == (output.scale.slope < 0)",
        "upwards = lower_si != (output.scale.slope < 0)",
        ("tests/guard/test_guard.py",),
    ),
    Bug(
        "the upper limit of an output is not looked at",
        "pmabench/guard/limits.py",
        "asked_inside = output.low - slack <= value <= output.high + slack",
        "asked_inside = output.low - slack <= value",
        ("tests/guard/test_guard.py",),
    ),
    Bug(
        "a measured value that is no number is no crossing",
        "pmabench/engine/watch.py",
        "outside = ~np.isfinite(samples)",
        "outside = np.zeros(len(samples), dtype=bool)",
        ("tests/engine/test_watch_range.py",),
    ),
    Bug(
        "a pressure at its limit is inside",
        "pmabench/engine/watch.py",
        "outside |= samples >= limit.high",
        "outside |= samples > 1.05 * limit.high",
        ("tests/engine/test_watch_range.py",),
    ),
    Bug(
        "revolutions are taken for radians",
        "pmabench/files/quantity.py",
        "factor /= 2 * pi  # rpm, rad/s, turn/s",
        "pass",
        ("tests/files/test_quantity.py",),
    ),
    Bug(
        "a quantity beyond all range is taken",
        "pmabench/files/quantity.py",
        "    if not isfinite(number):\n        raise ValueError(f'\"{value}\" is out of all range')",
        "    pass",
        ("tests/files/test_quantity.py",),
    ),
)
