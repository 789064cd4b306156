"""LabVIEW, TDMS and MATLAB files give the numbers that were written; a hostile one ends its reader and nothing else."""

import os
import signal
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.cli.main import main
from pmabench.store.formats.lvm import read_lvm
from pmabench.store.importers import apart
from pmabench.store.importers.apart import ReaderMissing, read_apart
from pmabench.store.reader import open_run
from tests import fixtures_foreign as made
from tests.importing import import_files, read_map

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"
FILES = {
    "one.lvm": "lvm",
    "comma.lvm": "lvm",
    "segments.lvm": "lvm",
    "bench.tdms": "tdms",
    "log5.mat": "mat",
    "log73.mat": "mat",
}
COLUMNS = {
    "lvm": {"t": "X_Value", **made.NAMES},
    "tdms": {"t": "bench/@time", **{key: f"bench/{name}" for key, name in made.NAMES.items()}},
    "mat": {
        "t": "log.time_s",
        "P": "log.pressure_mA",
        "F": "log.FX(:,1)",
        "x": "log.FX(:,2)",
        "command": "log.cmd_bar",
    },
}


def read(kind, content, wanted=None):
    question = {"layout": {"format": kind}, "wanted": wanted, "optional": [], "ignored": []}
    (answer,) = read_apart(kind, "old", [content], question)
    return answer


def refused(kind, content, wanted=None):
    with pytest.raises(InvalidFile) as caught:
        read(kind, content, wanted)
    return str(caught.value)


def test_the_fixtures_are_what_their_script_makes(tmp_path):
    made.make(tmp_path)
    for name, kind in FILES.items():
        kept, again = OLD / "foreign" / name, tmp_path / name
        if kind == "lvm":
            assert kept.read_bytes() == again.read_bytes()
        columns = [read(kind, path.read_bytes()).columns for path in (kept, again)]
        assert all(np.array_equal(columns[0][each], columns[1][each]) for each in columns[0])
    assert sum(p.stat().st_size for p in (OLD / "foreign").iterdir()) < 200_000


@pytest.mark.parametrize("name", FILES)
def test_the_numbers_are_those_that_were_written(name):
    kind = FILES[name]
    found = read(kind, (OLD / "foreign" / name).read_bytes()).columns
    for key, values in made.truth().items():
        np.testing.assert_allclose(found[COLUMNS[kind][key]], values, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", FILES)
def test_planted_faults_are_found_with_index_and_time(tmp_path, name):
    (run,) = import_files([OLD / "foreign" / name], OLD / f"{FILES[name]}.yaml", tmp_path)
    found = {finding.kind: finding for finding in run.findings}
    assert (found["dropout"].index, found["dropout"].count) == (made.CUT[0], 2)
    assert found["dropout"].t == pytest.approx(made.CUT[0] / made.RATE)
    assert found["stale"].index == made.STUCK[0] + 31
    assert [trial.commands[0].t for trial in open_run(run.path).trials] == pytest.approx([1.5, 3.5])
    started = open_run(run.path).manifest
    assert started["imported"]["started_known"] is (FILES[name] != "mat")
    if FILES[name] != "mat":
        assert started["started_utc"].startswith("2026-01-07T09:30:15.25")


def test_a_unit_that_contradicts_the_file_is_refused(tmp_path):
    text = (
        (OLD / "lvm.yaml")
        .read_text(encoding="utf-8")
        .replace("Load cell: {is: force, unit: N", "Load cell: {is: force, unit: kN")
    )
    (tmp_path / "map.yaml").write_text(text.replace("[-50 N, 1000 N]", "[-50 kN, 1000 kN]"), encoding="utf-8")
    with pytest.raises(InvalidFile, match='the unit of "Load cell" is N, the map says kN'):
        import_files([OLD / "foreign" / "one.lvm"], tmp_path / "map.yaml", tmp_path / "out")


def test_a_file_without_any_time_takes_its_period_from_the_map(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "old.mat", {"P": made.truth()["P"], "Fx": made.truth()["F"]})
    (tmp_path / "map.yaml").write_text(
        """\
schema: pmabench.map/1
name: a bench
source: nobody
kind: isometric
file: {format: mat, period: 10 ms}
columns:
  "@time": {is: time, unit: s}
  P: {is: pressure, unit: mA, points: [[4 mA, 0 bar], [20 mA, 8 bar]]}
  Fx: {is: force, unit: N}
sampling: {rate: [99 Hz, 101 Hz], gap: 50 ms}
trials: {by: file, point: {contraction: 4 mm}}
specimen: {type: muscle}
""",
        encoding="utf-8",
    )
    (run,) = import_files([tmp_path / "old.mat"], tmp_path / "map.yaml", tmp_path / "out")
    assert open_run(run.path).trials[0].t[-1] == pytest.approx(5.99)


def test_what_is_missing_or_unlike_is_reported_with_what_there_is():
    content = (OLD / "foreign" / "bench.tdms").read_bytes()
    assert 'did you mean "bench/Load cell"?' in refused("tdms", content, ["bench/Load cel"])
    assert "not equally long" in refused("tdms", content, ["bench/Load cell", "room/temperature"])
    assert "is no TDMS file" in refused("tdms", b"t,p,f\n0,1,2\n")
    assert "neither" in refused("mat", b"\0\0\0\0 an old version 4 perhaps")
    assert "no LVM file" in refused("lvm", b"t,p,f\n")


@pytest.mark.parametrize(
    ("wrong", "right", "line", "message"),
    [
        ("239.340000", "239.34x000", 24, '"239.34x000" is no number'),
        ("239.340000\t", "", 24, "has 4 columns, 5 are expected"),
        ("Separator\tTab", "Separator\tSemi", 4, "neither Tab nor Comma"),
        ("X_Columns\tOne", "X_Columns\tSome", 0, 'says X_Columns "Some"'),
        ("Channels\t4", "Channels\t900", 23, "number of channels"),
    ],
)
def test_faults_of_an_lvm_file_are_reported_at_their_line(wrong, right, line, message):
    text = made.lvm("One").replace("\r\n", "\n")
    assert wrong in text
    with pytest.raises(InvalidFile) as caught:
        read_lvm("old.lvm", text.replace(wrong, right, 1).encode())
    (problem,) = caught.value.problems
    assert problem.line == line
    assert message in problem.message


def test_rows_that_an_lvm_header_promises_and_that_are_not_there_are_a_doubt():
    lines = made.lvm("No").split("\r\n")
    recorded = read_lvm("old.lvm", "\r\n".join([*lines[:200], *lines[201:]]).encode())
    assert "has 599 rows, its header says 600" in recorded.doubts[0]
    cut = read_lvm("old.lvm", "\r\n".join(lines[:200]).encode())
    assert cut.cut_end


def test_the_checksum_of_a_compressed_mat_file_is_looked_at():
    content = bytearray((OLD / "foreign" / "log5.mat").read_bytes())
    size = struct.unpack("<I", content[132:136])[0]
    content[136 + size - 1] ^= 1
    assert "checksum" in refused("mat", bytes(content))


def mat5(size, data):
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, size) + data


@pytest.mark.slow
def test_a_small_file_that_unpacks_to_gigabytes_is_refused():
    packer = zlib.compressobj(9, wbits=-15)
    head = struct.pack("<IIIIIIIIIIIIII", 14, 4_000_000_000, 6, 8, 6, 0, 5, 8, 500_000_000, 1, 1, 0, 9, 4_000_000_000)
    begin = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    zeros = packer.compress(b"\0" * 10_000_000) + packer.flush(zlib.Z_FULL_FLUSH)
    checksum = zlib.adler32(head)
    for _ in range(150):
        checksum = zlib.adler32(b"\0" * 10_000_000, checksum)
    data = b"\x78\xda" + begin + zeros * 150 + packer.flush() + checksum.to_bytes(4, "big")
    assert len(data) < 2_000_000
    reported = refused("mat", mat5(len(data), data))
    assert "memory" in reported or "CPU" in reported
    assert read("mat", (OLD / "foreign" / "log5.mat").read_bytes()).columns


def test_what_a_file_only_claims_to_hold_takes_no_memory_here(tmp_path):
    import h5py

    with h5py.File(tmp_path / "huge.mat", "w", userblock_size=512) as file:
        file.create_dataset("P", shape=(1, 10**12), dtype="f8", chunks=(1, 1000))
    content = bytearray((tmp_path / "huge.mat").read_bytes())
    content[:10] = b"MATLAB 7.3"
    assert "more than 2 GB of memory" in refused("mat", bytes(content))


def test_a_link_to_another_file_is_not_followed(tmp_path):
    import h5py

    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["P"] = np.arange(5.0)
    for number, build in enumerate(
        (
            lambda file: file.__setitem__("P", h5py.ExternalLink(str(secret), "P")),
            lambda file: file.create_dataset("P", (5,), "f8", external=[(str(secret), 0, 40)]),
        )
    ):
        path = tmp_path / f"{number}.mat"
        with h5py.File(path, "w", userblock_size=512) as file:
            build(file)
        assert "not followed" in refused("mat", b"MATLAB 7.3" + path.read_bytes()[10:])


@pytest.mark.skipif(not hasattr(signal, "SIGSEGV"), reason="not run: no signals")
def test_a_reader_that_crashes_or_is_killed_is_replaced(monkeypatch):
    content = (OLD / "foreign" / "one.lvm").read_bytes()
    read("lvm", content)
    first = apart._children["lvm"].process.pid
    os.kill(first, signal.SIGSTOP)
    monkeypatch.setattr(apart, "START", 0.2)
    monkeypatch.setattr(apart, "WALL", 0.0)
    assert "made its reader end (SIGKILL)" in refused("lvm", content)
    monkeypatch.undo()
    assert read("lvm", content).columns
    second = apart._children["lvm"].process.pid
    os.kill(second, signal.SIGSEGV)
    apart._children["lvm"].process.wait(10)
    assert read("lvm", content).columns
    assert len({first, second, apart._children["lvm"].process.pid}) == 3


@pytest.mark.skipif(not hasattr(signal, "SIGPROF"), reason="not run: no signals")
def test_what_takes_too_long_ends_by_its_seconds_of_cpu():
    code = "from pmabench.base.system import end_after_cpu\nend_after_cpu(0.05)\nwhile True: pass"
    ended = subprocess.run([sys.executable, "-c", code], timeout=60, check=False)
    assert ended.returncode == -signal.SIGPROF
    assert "more than 2.0 s of CPU" in apart._why(ended.returncode, 1000)


def test_a_package_that_is_not_installed_is_named_with_the_remedy(tmp_path, monkeypatch):
    (tmp_path / "h5py.py").write_text("raise ImportError('no h5py here')\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    apart.close_readers()
    try:
        with pytest.raises(
            ReaderMissing, match=r'h5py, which is not installed.*pip install "pmabench\[import\]"'
        ) as caught:
            read("mat", (OLD / "foreign" / "log5.mat").read_bytes())
        assert caught.value.exit_code == 3
    finally:
        apart.close_readers()


def test_the_maps_name_every_format():
    assert {read_map(OLD / f"{kind}.yaml").file.file.format for kind in ("lvm", "tdms", "mat")} == {
        "lvm",
        "tdms",
        "mat",
    }


def test_names_in_a_file_reach_no_terminal_as_they_are(tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    evil = "\x1b[2J\x9b31mroom\nfault: none"
    data, names = made.truth(), {key: made.NAMES[key] for key in ("P", "F", "x", "command")}
    with TdmsWriter(tmp_path / "evil.tdms") as writer:
        timing = {"wf_increment": 0.01, "wf_start_offset": 0.0}
        channels = [ChannelObject("bench", name, data[key], timing) for key, name in names.items()]
        writer.write_segment([*channels, ChannelObject("bench", evil, data["F"], timing)])
    for args in (
        ["import", tmp_path / "evil.tdms", "--map", OLD / "tdms.yaml", "--out", tmp_path / "runs", "-v"],
        ["import", "--guess", tmp_path / "evil.tdms"],
    ):
        reported = CliRunner().invoke(main, [str(arg) for arg in args], catch_exceptions=False)
        assert reported.exit_code == 0
        assert "room" in reported.output
        assert not {"\x1b", "\x9b"} & set(reported.output)
        assert "\nfault: none" not in reported.output


def test_the_header_of_a_segment_may_begin_with_any_of_its_keys():
    """`Notes` before `Channels`, as LabVIEW writes it where the measurement has a description."""
    content = (OLD / "foreign" / "one.lvm").read_bytes()
    expected = read("lvm", content).columns
    for line in (b"Notes\tmuscle 3, new hose\r\n", b"Test_Name\tpull\r\nNotes\tChannels of the second rig\r\n"):
        noted = content.replace(b"Channels\t", line + b"Channels\t", 1)
        assert noted != content
        found = read("lvm", noted).columns
        assert all(np.array_equal(found[name], expected[name]) for name in expected)


def test_an_lvm_file_that_is_cut_in_mid_row_is_read_to_its_last_whole_row():
    content = (OLD / "foreign" / "one.lvm").read_bytes().rstrip()
    expected = read("lvm", content + b"\r\n").columns
    answer = read("lvm", content[: content.rindex(b"\t", 0, content.rindex(b"\t")) - 3])
    assert all(np.array_equal(answer.columns[name], expected[name][:-1]) for name in expected)
    assert any("the last row is cut off" in text and "left out" in text for text in answer.head["doubts"])


@pytest.mark.parametrize(("later", "together"), [(3.0, True), (300.0, False)])
def test_channels_that_begin_apart_have_no_clock_in_common(tmp_path, later, together):
    """Force that began 300 ms after the pressure was put on one clock with it; a part of a sample is none of it."""
    from nptdms import ChannelObject, TdmsWriter

    data, begin = made.truth(), np.datetime64("2026-01-05T10:00:00")
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        timing = {"wf_increment": 0.01, "wf_start_offset": 0.25}
        starts = {"P": begin, "F": begin + np.timedelta64(int(1e3 * later), "us")}
        writer.write_segment(
            [ChannelObject("g", k, data[k], {**timing, "wf_start_time": at}) for k, at in starts.items()]
        )
    content = (tmp_path / "a.tdms").read_bytes()
    columns = read("tdms", content).columns
    assert ("g/@time" in columns) == together
    if together:
        assert columns["g/@time"][:2] == pytest.approx([0.25, 0.26])
    else:
        assert 'channels of "g" begin up to 0.3 s apart' in refused("tdms", content, ["g/@time", "g/P"])
    for columns_are in ("No", "One", "Multi"):
        text = made.lvm(columns_are)
        end = text.index("\r\n", text.index("\r\nTime\t", text.index("Channels\t")) + 7)
        other = f"{text[: end - 6]}{250_000 + int(1e3 * later)}{text[end:]}".encode()
        if together:
            assert read("lvm", other).columns
        else:
            assert "begin up to 0.3 s apart (Time, X0)" in refused("lvm", other)
