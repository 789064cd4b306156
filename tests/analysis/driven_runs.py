"""Runs of shipped protocols on shipped benches in virtual time, through the engine and the store, for tests."""

from __future__ import annotations

from pathlib import Path

from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan
from pmabench.protocol.plan import Plan
from pmabench.store.reader import open_run
from pmabench.store.records import RunData

ROOT = Path(__file__).resolve().parents[2]


def planned(protocol: str, bench: str, specimen: str, *settings: tuple[str, str]) -> Plan:
    mounted = mount(
        ROOT / "fixtures" / "benches" / f"{bench}.yaml", ROOT / "fixtures" / "specimens" / f"{specimen}.yaml"
    )
    return make_plan(ROOT / "protocols" / f"{protocol}.yaml", mounted, settings)[0]


def recorded(out: Path, protocol: str, bench: str, specimen: str, *settings: tuple[str, str]) -> RunData:
    mounted = mount(
        ROOT / "fixtures" / "benches" / f"{bench}.yaml", ROOT / "fixtures" / "specimens" / f"{specimen}.yaml"
    )
    plan = make_plan(ROOT / "protocols" / f"{protocol}.yaml", mounted, settings)[0]
    outcome = run_plan(plan, mounted, ConfirmedBeforehand(), out=out)
    assert outcome.exit_code == 0, outcome.why
    assert outcome.folder is not None
    return open_run(outcome.folder)
