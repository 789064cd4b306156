"""How long the list of a thousand runs takes, read for the first time and from the cache; processor time, printed."""

import time

import pytest

from pmabench.store.catalogue import CACHE, catalogue
from pmabench.store.folder import open_json, sealed_json
from tests.store.runs import closed

RUNS = 1000
LIMIT = 1.0
"""Processor time of one list [s]."""


@pytest.fixture(scope="module")
def parent(tmp_path_factory):
    """Closed runs with manifests and seals as long as those of the engine."""
    parent = tmp_path_factory.mktemp("runs")
    first = closed(tmp_path_factory.mktemp("one"), rows=20)
    manifest, seal = (open_json((first / name).read_bytes(), name) for name in ("manifest.json", "seal.json"))
    for data in (manifest, seal):
        del data["sha256"]
    manifest["devices"] = {f"device {n}": {"serial": "x" * 40, "channels": ["y" * 40] * 8} for n in range(12)}
    seal["end"] = {"vent": {"result": "confirmed", "actions": ["z" * 60] * 20}}
    for number in range(RUNS):
        folder = parent / f"20261121-{number:04d}_A017_static-load_{number:04x}"
        folder.mkdir()
        (folder / "manifest.json").write_bytes(sealed_json(manifest | {"id": folder.name}))
        (folder / "seal.json").write_bytes(sealed_json(seal | {"id": folder.name}))
    return parent


def seconds(parent):
    """Processor time of a list, the best of three."""
    best = float("inf")
    for _ in range(3):
        began = time.process_time()
        assert len(catalogue(parent)) == RUNS
        best = min(best, time.process_time() - began)
    return best


def test_a_thousand_runs_are_listed_within_a_second(parent, capsys):
    began = time.process_time()
    assert len(catalogue(parent)) == RUNS
    first = time.process_time() - began
    again = seconds(parent)
    (parent / CACHE).unlink()
    with capsys.disabled():
        print(f"\n{RUNS} runs: {first:.3f} s read for the first time, {again:.3f} s from the cache")
    assert max(first, again) < LIMIT
    assert again < first
