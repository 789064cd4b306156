"""The law `relay`: it stays in its range, ends at every window, and never commands what is no number."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Any

import pytest

from pmabench.engine.laws.relay import Relay


def law(**change: Any) -> Relay:
    given: dict[str, Any] = {
        "setpoint": 0.03, "bias": 2e5, "amplitudes": [1e4, 2e4], "hysteresis": [1e-4, 2e-4], "low": 1e5, "high": 3e5,
        "periods": 3, "level_time": 5.0, "settle": 1.0, "window": 5e-3, "watched": {"pressure": [1e5, 3e5]},
    }  # fmt: skip
    return Relay(**{**given, **change})


def drive(relay: Relay, times: int = 4000, h: float = 1e-3) -> list[float]:
    """An integrator around the centre: x' = (u - bias)/1e6 in m and Pa."""
    x, commands = 0.03, []
    for k in range(times):
        command = relay.update(k * h, {"displacement": x, "pressure": 2e5})
        commands.append(command)
        if relay.done:
            break
        x += h * (command - relay.bias) / 1e6
    return commands


def test_it_switches_between_two_values_at_each_amplitude_and_ends_at_the_bias() -> None:
    relay = law()
    commands = drive(relay)
    expected = {2e5, 2e5 + 1e4, 2e5 - 1e4, 2e5 + 2e4, 2e5 - 2e4}
    assert {round(value, 6) for value in commands} == {round(value, 6) for value in expected}
    found = relay.result()
    assert found["found"]
    assert relay.done
    assert commands[-1] == 2e5
    assert [len(level["switches"]) for level in found["relay"]] == [6, 6] or found["relay"][0]["switches"]
    assert found["centre"] == pytest.approx(0.03)


@pytest.mark.parametrize("name", ["displacement", "pressure"])
@pytest.mark.parametrize("value", [nan, inf, -inf, None])
def test_a_channel_that_is_no_number_ends_it_at_the_bias(name: str, value: float | None) -> None:
    relay = law()
    for k in range(1200):
        relay.update(k * 1e-3, {"displacement": 0.03, "pressure": 2e5})
    values = {"displacement": 0.03, "pressure": 2e5}
    if value is None:
        del values[name]
    else:
        values[name] = value
    command = relay.update(1.2, values)
    assert isfinite(command)
    assert command == 2e5
    assert relay.result()["ended"] == "no signal"
    assert relay.update(1.3, {"displacement": 0.03, "pressure": 2e5}) == 2e5


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"displacement": 0.0351, "pressure": 2e5}, "window"),
        ({"displacement": 0.03, "pressure": 3.01e5}, "pressure"),
        ({"displacement": 0.03, "pressure": 2e5, "force": 101.0}, "force"),
    ],
)
def test_each_window_ends_it_also_while_it_settles(values: dict[str, float], why: str) -> None:
    for before in (0, 1500):
        relay = law(watched={"pressure": [1e5, 3e5], "force": [-1.0, 100.0]})
        for k in range(before):
            relay.update(k * 1e-3, {"displacement": 0.03, "pressure": 2e5, "force": 50.0})
        assert relay.update(before * 1e-3, {"force": 50.0, **values}) == 2e5
        assert relay.result()["ended"] == why
        assert why.split()[0] in relay.result()["reason"] or why == "window"
        assert not relay.result()["found"]


def test_a_loop_that_does_not_switch_ends_it() -> None:
    relay = law()
    for k in range(7000):
        relay.update(k * 1e-3, {"displacement": 0.03, "pressure": 2e5})
    assert relay.result()["ended"] == "slow"


@pytest.mark.parametrize(
    "change",
    [
        {"amplitudes": [2e5, 4e5]},
        {"hysteresis": [1e-4]},
        {"hysteresis": [1e-4, 0.0]},
        {"amplitudes": [1e4, nan]},
        {"window": 1e-4},
        {"periods": 1},
    ],
)
def test_nonsense_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must|leaves|too small"):
        law(**change)
