"""Lines of the self-test's table, those of a bench at rest, and the refusal that names what is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from pmabench.base.errors import VerdictFailed
from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord
from pmabench.bench.safety import SUPPLY_MARGIN
from pmabench.session.guided import Series

OK, FAILED, NOT_MEASURED, NOT_CHECKED = "ok", "failed", "not measured", "not checked"


@dataclass(frozen=True)
class Check:
    """What was looked at, what was found, what is allowed; `hint` says where to look when it failed."""

    name: str
    value: str
    limit: str = ""
    verdict: str = OK
    hint: str = ""


class SelfTestFailed(VerdictFailed):
    """The bench is not fit for a run."""


def judged(name: str, value: str, limit: str, *, good: bool, hint: str) -> Check:
    """A check with its verdict."""
    return Check(name, value, limit, OK if good else FAILED, "" if good else hint)


def refuse(checks: Sequence[Check]) -> None:
    """Raise SelfTestFailed where a check has failed, with every hint."""
    failed = [check for check in checks if check.verdict == FAILED]
    if failed:
        reasons = "; ".join(f"{check.name} {check.value}: {check.hint}" for check in failed)
        raise SelfTestFailed(f"the self-test failed: {reasons}")


def at_rest(mounted: Mounted, series: Mapping[str, Series], noise: Mapping[str, float]) -> list[Check]:
    """The checks of a vented bench that need no reference; `noise` [SI] is the most that each channel may have."""
    channels = {channel.name: channel for channel in mounted.bench.channels}
    checks = [check for name, one in series.items() for check in _noise(channels[name], one, noise)]
    return [*checks, *_supply(mounted, series)]


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


def _supply(mounted: Mounted, series: Mapping[str, Series]) -> Iterator[Check]:
    output = next((output for output in mounted.bench.outputs if output.name == "pressure"), None)
    if output is None:
        return
    if "supply" not in series:
        yield Check("supply at rest", "", "", NOT_MEASURED, "no channel for it on this bench")
        return
    least, mean = output.high + SUPPLY_MARGIN, series["supply"].mean()
    yield judged(
        "supply at rest",
        show(mean, "pressure", 4),
        f"at least {show(least, 'pressure', 4)}",
        good=mean >= least,
        hint=f"it must be {show(SUPPLY_MARGIN, 'pressure')} above the highest set-point: look at the supply, its valve "
        "and filter, or at the wire of its sensor",
    )
