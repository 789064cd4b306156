"""Protocols with a relay: what could not tell friction, or would leave its range, is refused with its place."""

from __future__ import annotations

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.protocol.plan import Seek
from tests.protocol.test_compile import plan


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("trial.relay.hysteresis", "[0.1 mm, 0.1 mm]", "one ratio"),
        ("trial.relay.hysteresis", "[0.1 mm, 0.2 mm, 0.3 mm]", "as many values"),
        ("trial.relay.amplitudes", "[20 kPa, 300 kPa]", "outside the range"),
        ("trial.relay.amplitudes", "[20 kPa, 0 kPa]", "above zero"),
        ("trial.relay.measured", "[300 kPa, 400 kPa]", 'window "measured"'),
        ("trial.relay.window", "0.3 mm", "twice the largest hysteresis"),
    ],
)
def test_a_relay_that_makes_no_sense_is_refused(key: str, value: str, words: str) -> None:
    with pytest.raises(InvalidFile, match=words):
        plan("ultimate-gain-relay", (key, value), bench="mock")


def test_the_search_stays_in_its_windows() -> None:
    """Commands of the relay are inside the range; the watched channels are those that the protocol names."""
    steps = plan("ultimate-gain-relay", ("sweep.repeat.count", "1"), bench="mock").steps
    (seek,) = [step for step in steps if isinstance(step, Seek)]
    assert (seek.law, seek.low, seek.high) == ("relay", 2e4, 5e5)
    assert seek.parameters["watched"] == {"pressure": [2e4, 5e5]}
    assert seek.limit > 4.0 + 2 * 20.0
