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
        "a safe ramp begins at the end of the last ramp",
        "pmabench/guard/guard.py",
        "self._courses[name] = course.ramp(self.clock.now(), origin, target, rate)",
        "self._courses[name] = course.step(target)",
        ("tests/guard/test_safe_state.py",),
    ),
    Bug(
        "a bench can be armed again after a trip",
        "pmabench/guard/guard.py",
        "        if self.state is not State.DISARMED:\n",
        "        if False:\n",
        ("tests/guard/test_arming.py",),
    ),
    Bug(
        "commands pass after the safe state",
        "pmabench/guard/guard.py",
        "        if self.state not in {State.SETUP, State.RUNNING}:\n",
        "        if self.state is State.DISARMED:\n",
        ("tests/guard/test_safe_state.py",),
    ),
    Bug(
        "a watchdog that fails is not noticed",
        "pmabench/guard/links.py",
        "                        before.get(record.name)\n",
        "                        pass\n",
        ("tests/guard/test_safe_state.py",),
    ),
    Bug(
        "the valve's coil is taken the wrong way round",
        "pmabench/guard/links.py",
        'on=closed == (valve.energised == "closed")',
        'on=closed == (valve.energised == "open")',
        ("tests/guard/test_arming.py",),
    ),
    Bug(
        "a call that hangs is waited for again and again",
        "pmabench/guard/owner.py",
        "            self._late = call\n",
        "",
        ("tests/guard/test_safe_state.py",),
    ),
    Bug(
        "a measured value at its bound confirms the vent",
        "pmabench/guard/safe.py",
        "if value is not None and self._floors.get(action.target, -inf) < value < action.value:",
        "if value is not None and self._floors.get(action.target, -inf) < value <= action.value:",
        ("tests/guard/test_safe_state.py",),
    ),
    Bug(
        "the safe state is sent only once",
        "pmabench/guard/safe.py",
        "REPEAT = 0.5",
        "REPEAT = 500.0",
        ("tests/guard/test_safe_state.py",),
    ),
    Bug(
        "a state that cannot be read is no latch",
        "pmabench/guard/station.py",
        'if state.get("what") == "safe" or not (state or (self.folder / "state.json").exists()):',
        'if state.get("what") not in {"armed", "tripped"}:',
        ("tests/guard/test_station.py",),
    ),
    Bug(
        "an engine may be silent for ever",
        "pmabench/guard/process.py",
        "if now - self._heard > SILENCE and not self._said():",
        "if now - self._heard > 1e9 and not self._said():",
        ("tests/guard/test_service.py",),
    ),
    Bug(
        "a guard that stood still carries out what is old",
        "pmabench/guard/process.py",
        "abs(time.monotonic() - sent) <= STALE",
        "sent <= time.monotonic()",
        ("tests/guard/test_service.py",),
    ),
    Bug(
        "anybody may command",
        "pmabench/guard/process.py",
        'if message.pop("token", "") != self._token:',
        'if not message.pop("token", ""):',
        ("tests/guard/test_service.py",),
    ),
    Bug(
        "the engine is believed against the guard's own channel",
        "pmabench/guard/process.py",
        "for name, value in seen.items() if name not in own}",
        "for name, value in seen.items() if name}",
        ("tests/guard/test_service.py",),
    ),
    Bug(
        "a burst is judged by the end of its block",
        "pmabench/engine/watch.py",
        "allowed = self._commanded.falling(limit.channel, t) * window",
        "allowed = self._commanded.falling(limit.channel, t[-1:]) * window",
        ("tests/engine/test_watch.py",),
    ),
    Bug(
        "a delay begins again with every block",
        "pmabench/engine/watch.py",
        "watched.since = float(since) if since is not None and outside[-1] else None",
        "watched.since = None",
        ("tests/engine/test_watch.py",),
    ),
    Bug(
        "a controlled stop is cut by its own cause",
        "pmabench/engine/run.py",
        "            self.acquisition.begin_controlled_stop()\n",
        "",
        ("tests/engine/test_faults_in_virtual_time.py",),
    ),
    Bug(
        "a lost record hides that the vent was not confirmed",
        "pmabench/engine/ending.py",
        "    if not vent.confirmed or isinstance(cause, LimitTripped):\n        return 5\n    if lost is not None:\n        return 7\n",
        "    if lost is not None:\n        return 7\n    if not vent.confirmed or isinstance(cause, LimitTripped):\n        return 5\n",
        ("tests/engine/test_faults_in_virtual_time.py",),
    ),
    Bug(
        "a stream that is late is taken for one that is there",
        "pmabench/engine/watch.py",
        "if now - watched.heard >= limit.delay:",
        "if now - watched.heard >= 10 * limit.delay:",
        ("tests/engine/test_watch.py",),
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
