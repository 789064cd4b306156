"""What the list of a thousand runs costs, over reading its files."""

import json

import pytest

from pmabench.store.catalogue import catalogue
from pmabench.store.folder import open_json, sealed_json
from tests.benchmarks.least import least
from tests.store.runs import closed

RUNS = 1000
MOST = 10
"""Times the processor time that reading the files takes."""


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


def bare(parent):
    """Both files of each run, read and understood."""
    return [
        [json.loads((folder / name).read_bytes()) for name in ("manifest.json", "seal.json")]
        for folder in sorted(parent.iterdir())
    ]


def test_a_list_costs_little_more_than_reading_its_files(parent):
    alone, read = least(lambda: bare(parent))
    listed, rows = least(lambda: catalogue(parent))
    print(
        f"\n{RUNS} runs: reading alone {alone:.3f} s, the list {listed:.3f} s, {listed / alone:.1f} times, at most {MOST}"
    )
    assert len(rows) == len(read) == RUNS
    assert listed < MOST * alone
