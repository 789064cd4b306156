"""Channels without pressure: noise, plausible readings, swapped plugs, supply; before anything is commanded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord
from pmabench.bench.trips import SUPPLY_MARGIN
from pmabench.session.checks import Check, judged
from pmabench.session.listening import Series

SHARE = 0.02
"""Reading at rest that is believed where the bench file has no limit for the zero, of the range."""
PLAUSIBLE = ("pressure", "force", "displacement")
"""Channels whose plugs may be swapped."""


def at_rest(
    mounted: Mounted, series: Mapping[str, Series], noise: Mapping[str, float], *, unloaded: bool
) -> list[Check]:
    """The checks of a vented bench; `unloaded`: hands have taken every load off."""
    channels = {channel.name: channel for channel in mounted.bench.channels}
    checks = [check for name, one in series.items() for check in _noise(channels[name], one, noise)]
    means = {name: one.mean() for name, one in series.items()}
    swap = swapped(mounted, channels, means)
    if swap is not None:
        one, other = swap
        where = " and ".join(f"{channels[name].device}.{channels[name].input}" for name in swap)
        value = " and ".join(f"{name} reads {show(means[name], channels[name].quantity, 4)}" for name in swap)
        checks.append(
            judged(
                "swapped channels",
                value,
                "0 at rest",
                good=False,
                hint=f"each reads what the other should at rest: the plugs of {one} and {other} are swapped ({where})",
            )
        )
    else:
        checks += [check for name in ("pressure", "force") for check in _rest(mounted, channels, means, name, unloaded)]
    checks += _supply(mounted, means)
    return checks


def _noise(channel: ChannelRecord, series: Series, limits: Mapping[str, float]) -> Iterator[Check]:
    name, quantity = channel.name, channel.quantity
    if name.endswith("_command"):
        return
    noise, limit = series.reading().noise, limits[name]
    resolution = abs(channel.scale.slope) if channel.raw_type == "int32" else 0.0
    step = f", resolution {show(resolution, quantity, 2)}" if resolution else ""
    yield judged(
        f"noise of {name}",
        f"{show(noise, quantity, 3)} rms{step}",
        f"at most {show(limit, quantity, 3)}",
        good=noise <= limit,
        hint=f"look at shield and ground of the wire to {channel.device}.{channel.input}",
    )


def allowed_at_rest(mounted: Mounted, channel: ChannelRecord) -> float:
    """How far from zero a vented, unloaded channel may read [SI]."""
    zero = mounted.session.zeros.get(channel.name) if mounted.session is not None else None
    return zero.most if zero is not None else SHARE * (channel.high - channel.low)


def _rest(
    mounted: Mounted, channels: Mapping[str, ChannelRecord], means: Mapping[str, float], name: str, unloaded: bool
) -> Iterator[Check]:
    if name not in means or (name == "force" and not unloaded):
        return
    channel = channels[name]
    limit = allowed_at_rest(mounted, channel)
    state = "vented" if name == "pressure" else "unloaded"
    yield judged(
        f"{name} at rest",
        show(means[name], channel.quantity, 4),
        f"within {show(limit, channel.quantity, 4)} of 0, {state}",
        good=abs(means[name]) <= limit,
        hint=f"look at the wire {channel.device}.{channel.input}, at its range, and at its calibration",
    )


def swapped(
    mounted: Mounted, channels: Mapping[str, ChannelRecord], means: Mapping[str, float]
) -> tuple[str, str] | None:
    """Two channels that are implausible at rest and plausible when each is read as the other; None for none."""
    for one, other in combinations([name for name in PLAUSIBLE if name in means], 2):
        if _plausible(mounted, channels, one, means[one]) and _plausible(mounted, channels, other, means[other]):
            continue
        raw = {name: channels[name].scale.to_raw(means[name]) for name in (one, other)}
        crossed = {one: channels[one].scale.to_si(raw[other]), other: channels[other].scale.to_si(raw[one])}
        if all(_plausible(mounted, channels, name, value) for name, value in crossed.items()):
            return one, other
    return None


def _plausible(mounted: Mounted, channels: Mapping[str, ChannelRecord], name: str, value: float) -> bool:
    return abs(value) <= allowed_at_rest(mounted, channels[name])


def _supply(mounted: Mounted, means: Mapping[str, float]) -> Iterator[Check]:
    output = next((output for output in mounted.bench.outputs if output.name == "pressure"), None)
    if output is None:
        return
    if "supply" not in means:
        yield Check("supply at rest", "", "", "not measured", "no channel for it on this bench")
        return
    least = output.high + SUPPLY_MARGIN
    yield judged(
        "supply at rest",
        show(means["supply"], "pressure", 4),
        f"at least {show(least, 'pressure', 4)}",
        good=means["supply"] >= least,
        hint=f"it must be {show(SUPPLY_MARGIN, 'pressure')} above the highest set-point: look at the supply, its valve "
        "and filter, or at the wire of its sensor",
    )
