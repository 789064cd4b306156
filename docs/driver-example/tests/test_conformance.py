"""Every promise of a driver, as a test of this package."""

# ruff: noqa: S101, D103

from pathlib import Path

from pmabench.conformance import FAILED, run, subject

BENCH = Path(__file__).resolve().parents[1] / "bench.yaml"


def test_every_promise_is_kept():
    results = run(subject("pmabench_driver_example:ExampleController", BENCH), hostile=100)
    assert not [f"{result.check}: {result.why}" for result in results if result.verdict == FAILED]
