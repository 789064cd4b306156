"""A driver that was tried on an emulator only: said and asked once per bench and version, recorded, in the report."""

import datetime
from dataclasses import dataclass, field, replace

import pytest

from pmabench.bench.compile import mount_alone
from pmabench.bench.interface import DeviceRecord, Identity
from pmabench.engine.bench_checks import doubt
from pmabench.engine.operator import ConfirmedBeforehand, Nobody
from pmabench.report.document.provenance import benches
from pmabench.session.guided import hold_at
from pmabench.store.reader import open_run
from tests.engine.benches import ROOT, mounted
from tests.realtime import ended, with_service

T7 = Identity("LabJack", "T7", "470010103", "1.0292")


@pytest.mark.parametrize(
    ("verified", "firmware", "identity", "why"),
    [
        ("emulator only", "", T7, "was never tried on a device (verified: emulator only)"),
        ("emulator and compiled sketch, no board", "", T7, "was never tried on a device"),
        ("emulator only", "", replace(T7, simulated=True), ""),
        ("hardware (A. Lab, 2026-11-20)", "", T7, ""),
        ("hardware (A. Lab, 2026-11-20, firmware 1.0292)", "1.0292", T7, ""),
        ("hardware (A. Lab, 2026-11-20, firmware 1.0300)", "1.0300", T7, "and firmware 1.0292 answers"),
    ],
)
def test_what_is_doubted(verified, firmware, identity, why):
    device = DeviceRecord("daq", "a.b:C", verified=verified, verified_firmware=firmware)
    assert why in doubt(device, identity)
    assert bool(doubt(device, identity)) == bool(why)


@dataclass
class Person:
    """Answers everything, and remembers what was asked."""

    asked: list = field(default_factory=list)

    def ask(self, text, measured, wait):
        self.asked.append(text)
        return "clear"

    def poll(self, measured):
        return ()


def untried(tmp_path):
    bench = mounted("mock-realtime")
    device, log = with_service(bench.bench.devices[0], tmp_path, start=True)
    device = replace(device, driver="tests.session.untried_device:SaysHardware", verified="emulator only")
    return replace(bench, bench=replace(bench.bench, devices=(device,))), log


@pytest.mark.realtime
def test_it_is_asked_once_and_is_in_manifest_and_report(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # for the guard's process
    bench, log = untried(tmp_path)
    with ended(log):

        def held(operator):
            return hold_at(bench, "pressure", 20e3, operator, tmp_path, lambda *_: None, seconds=0.1)

        refused = held(Nobody())
        assert (refused.exit_code, refused.status) == (2, "error")
        assert not any(e.kind == "armed" for e in open_run(refused.folder).events)
        unattended = held(ConfirmedBeforehand())  # --yes answers, and is not remembered
        person = Person()
        outcomes = [unattended, held(person), held(person)]
    assert [outcome.status for outcome in outcomes] == ["finished"] * 3
    assert [text.startswith("The driver of") for text in person.asked] == [True, False, False]  # then the moves
    run = open_run(outcomes[0].folder)
    assert run.manifest["drivers"]["plant"]["verified"] == "emulator only"
    assert any(
        e.kind == "answer" and e.data["phase"] == "driver" and "--yes" in e.data["answer"]
        for e in run.events
        if "phase" in e.data
    )
    assert "T7" in benches([run])[0][1]
    assert "driver verified: emulator only" in benches([run])[0][1]


def test_a_lab_says_in_the_bench_file_what_it_compared(tmp_path):
    text = (ROOT / "fixtures/benches/wires.yaml").read_text()
    assert all(d.verified == "emulator only" for d in mount_alone(ROOT / "fixtures/benches/wires.yaml").bench.devices)
    name = next(iter(mount_alone(ROOT / "fixtures/benches/wires.yaml").bench.devices)).name
    assert text.count(f"  {name}:\n    driver:") == 1
    said = "    verified: {by: A. Lab, date: 2026-11-20, firmware: '1.0'}\n"
    folder = tmp_path / "benches"
    folder.mkdir()
    for part in ("calibrations", "registers"):
        (folder / part).symlink_to(ROOT / "fixtures/benches" / part)
    (folder / "mine.yaml").write_text(text.replace(f"  {name}:\n", f"  {name}:\n{said}"))
    device = mount_alone(folder / "mine.yaml", datetime.date(2026, 11, 22)).bench.devices[0]
    assert device.verified == "hardware (A. Lab, 2026-11-20, firmware 1.0)"
    assert device.verified_firmware == "1.0"
