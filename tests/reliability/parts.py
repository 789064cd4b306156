"""The table of the reliability harness: one line is one part; README.md beside this file says how to add one."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """Tests that are run with many cases on demand, and with few in every commit."""

    name: str
    promise: str
    """Numbers of the promises that the part keeps."""
    what: str
    cases: int
    """Cases on demand, for each test that asks `cases()`."""
    tests: tuple[str, ...]
    """What pytest is given."""


PARTS = (
    Part("kill", "R1, R2", "recorder killed (SIGKILL) at random instants", 1000, ("tests/store/test_killed.py",)),
    Part("power", "R1", "power cut at random instants, ext4", 1000, ("tests/reliability/test_power_cut.py",)),
    Part("disk", "R8", "full disk, read-only folder, n-th call fails", 40, ("tests/reliability/test_disk_faults.py",)),
    Part("full", "R13", "disk filled at an instant of a run: sealed, with cause and vent", 1, ("tests/reliability/test_full_disk.py",)),
    Part("fsize", "R8, R13", "limit on the size of files", 1000, ("tests/reliability/test_file_size.py",)),
    Part("bytes", "R3", "one byte of a closed run changed", 1000, ("tests/store/test_damage.py::test_verify_finds_every_changed_byte_in_every_kind_of_file",)),
    Part("cuts", "R1", "live stream cut at any length", 10**6, ("tests/store/test_damage.py::test_a_live_stream_cut_anywhere_gives_whole_batches_only",)),
    Part("readme", "R10", "lines of README.txt during a run", 1000, ("tests/store/test_readme.py::test_a_run_under_way_gives_whole_batches_at_every_moment",)),
    Part("notes", "R3", "note killed at every step", 1, ("tests/store/test_notes.py::test_a_note_that_is_killed_anywhere_is_there_whole_or_not_at_all",)),
    Part("clocks", "R6", "offset and drift within what is stated", 1000, ("tests/store/test_clocks.py::test_the_stated_uncertainty_holds_in_nineteen_of_twenty_cases",)),
    Part("same", "R4", "analysis again, byte by byte", 5, ("tests/reliability/test_same_bytes.py",)),
    Part("protocols", "S1", "generated and hostile protocols", 10_000, ("tests/engine/test_hostile_protocols.py",)),
    Part("evil", "S1, P3", "an engine that lies to its guard", 100_000, ("tests/guard/test_service.py::test_an_engine_that_lies_commands_nothing_illegal_and_the_guard_survives",)),
    Part("crash", "S6, S7b", "kill -9 vented within 0.1 s, SIGSTOP within 0.5 s (p99)", 10, ("tests/engine/test_killed_in_real_time.py",)),
    Part("trips", "S2", "fault to vent in real time, p99 within 2 blocks + 20 ms", 20, ("tests/engine/test_trips_in_real_time.py",)),
    Part("ways-out", "S3, S4, S5, R8", "every cause in every kind of step", 1, ("tests/engine/test_ways_out.py",)),
    Part("vent", "S7, S9, S10", "vent from outside; two starts at once", 20, ("tests/engine/test_vent_from_outside.py",)),
    Part("outside", "S11, S12, S13, S14, S15, R12", "independent regulator: faults, freezes, two owners, strangers", 20, ("tests/outside",)),
    Part("resume", "R7", "run killed and gone on with until done", 200, ("tests/engine/test_killed_and_resumed.py",)),
    Part("branches", "all of S", "branches of the guard's code", 1, ("tests/guard/test_branches.py",)),
    Part("rigs", "S3, S4, S6, S7b", "each driver over its wire, whole runs, everything killed", 10_000, ("tests/drivers", "tests/session/test_realtime.py")),
    Part("wrong-benches", "S16", "wrong bench files of five rigs: the self-test names the wire, right ones pass", 200, ("tests/session/test_wrong_benches.py", "tests/session/test_wrong_wires.py")),
    Part("hostile", "hostile input", "damaged answers to each driver, and every promise of a driver", 10_000, ("tests/conformance/test_drivers.py", "tests/conformance/test_suite.py")),
    Part("mutants", "S16", "one fault in a driver: the conformance suite finds it", 1, ("tests/conformance/test_mutants.py",)),
    Part("imports", "R5, hostile input", "damaged files of each format: no number changed in silence", 10_000, ("tests/store/test_import_fuzz.py",)),
    Part("platform", "S2, S5", "faults of a platform of three muscles: found within 1 s and vented, and no false trip", 16, ("tests/kinds/test_platform.py::test_a_fault_is_found_and_everything_is_vented_supply_first", "tests/kinds/test_platform.py::test_no_false_trip", "tests/kinds/test_platform.py::test_a_platform_that_swings_by_its_law_is_no_fault")),
    Part("clients", "S16, N5", "calls of clients that others wrote, each in an environment of its own", 1, ("tests/clients/test_clients.py", "tests/clients/own_environments.py")),
    Part("bugs", "all", "seeded bug makes its tests fail", 1, ("tests/reliability/seeded_bugs.py",)),
)  # fmt: skip
