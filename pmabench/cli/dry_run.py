"""The dry run of `check --simulate`: whose muscle is simulated, what the plan does on it, and that in a few lines.

The muscle is that of an earlier analysis of the same specimen or of a plant file, where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from textwrap import wrap
from typing import Any

from pmabench.base.errors import InvalidFile, UsageError
from pmabench.base.kind import load
from pmabench.base.quantities import CHANNEL_QUANTITY, in_words, show
from pmabench.bench.compile import Mounted
from pmabench.bench.dry_run import (
    PredictedMuscle,
    as_expected,
    by_surface,
    dry_run,
    highest_pressure,
    nearest_surface,
    of_specimen,
    options_of,
    several,
)
from pmabench.bench.files.specimen import ExpectedFile, ExpectedPoint, SpecimenFile
from pmabench.bench.plant import read_plant
from pmabench.cli.common import fields
from pmabench.cli.names import WIDTH
from pmabench.cli.outcome import cut
from pmabench.engine.executor import Progress
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.recorder import TrialPeaks
from pmabench.engine.run import Outcome, run_plan
from pmabench.kinds import registry
from pmabench.model.real.muscle import Surface
from pmabench.protocol.plan import Plan
from pmabench.protocol.sweep import idle_trials
from pmabench.report.certificate.force_chart import slopes_of
from pmabench.store.analyses.folder import analyses_below, read_analysis
from pmabench.store.analyses.results import Analysis
from pmabench.store.folder import run_name

PART = "intervals of a plan"
"""Part of a kind of test: what a plan will tell."""
ANALYSES = Path("analyses")
"""Where `process` puts analyses, in the folder in which it is called."""
PEAKS = ("pressure", "displacement", "force", "angle", "torque")
END = 1e-4
"""Share of a channel's range within which a value is at its end."""
MOST_FINDINGS = 3
RATE = 100.0
"""Highest rate of samples of a muscle with hysteresis [Hz]: its contractions stay within 0.01 mm of those at 500 Hz."""


def muscle_of(mounted: Mounted, given: Path | None) -> PredictedMuscle:
    """The best known muscle: an analysis or plant file that was `given`, else the newest analysis of this specimen.

    Then `expected` of the specimen file, then its type, then its braid. Of several muscles the braid alone.
    """
    if mounted.bench_file.muscles:
        if given is not None:
            raise UsageError(
                f'--muscle: "{mounted.bench.name}" has several muscles, and an analysis or a plant file describes one: '
                "leave it out, and muscles of the specimen's dimensions are simulated"
            )
        options, source = several(mounted)
        return PredictedMuscle(options, None, source)
    specimen, highest = mounted.specimen_file, highest_pressure(mounted)
    if given is not None:
        return of_file(given, specimen, highest)
    earlier = newest_of(ANALYSES, specimen, highest)
    if earlier is not None:
        return earlier
    if specimen.expected is not None:
        source = f"as expected in the specimen file: {specimen.expected.source}"
        return as_expected(specimen.expected, specimen, highest, source)
    return of_specimen(specimen, highest)


def simulate(
    plan: Plan,
    mounted: Mounted,
    muscle: PredictedMuscle | None,
    progress: Callable[[Progress], None] = lambda _progress: None,
) -> dict[str, Any]:
    """Run the plan in virtual time: on the simulated muscle of the bench file (`muscle` None), else on `muscle`.

    Where its force is uncertain, the others that it may have are looked at without simulation.
    """
    source, left_out, others = "", tuple[str, ...](), list[dict[str, Any]]()
    slow = plan.rate > RATE and (_slow(mounted) if muscle is None else muscle.numbers.get("law") == "real")
    if muscle is not None:
        dry = dry_run(mounted, options_of(muscle, mounted), muscle.source)
        source, left_out, mounted = muscle.source, dry.left_out, dry.mounted
        if slow:
            left_out = (*left_out, f"samples are taken at {RATE:g} Hz: this kind of simulated muscle needs long")
        others = [_at_rest(plan, muscle.times(factor / muscle.factors[0]), factor) for factor in muscle.factors[1:]]
    peaks = TrialPeaks(mounted.bench)
    plan = replace(plan, rate=RATE) if slow else plan
    outcome = run_plan(plan, mounted, ConfirmedBeforehand(), out=None, progress=progress, trying=peaks)
    predicted = [{"trial": peak.trial + 1, **fields(peak, "point", "highest", "duration")} for peak in peaks.trials]
    found = {"muscle": source, "left_out": left_out, **_result(outcome, mounted)}
    return found | {"predicted": predicted, "others": others}


def _at_rest(plan: Plan, muscle: PredictedMuscle, factor: float) -> dict[str, Any]:
    """Without simulation: what a muscle of another force cannot lift, and how far it contracts at most [m]."""
    points = [trial.point for trial in plan.trials if {"load", "pressure"} <= set(trial.point)]
    far = [muscle.contraction(point["pressure"], point["load"]) for point in points]
    idle = idle_trials(plan, muscle.expected) if muscle.expected is not None else None
    return {
        "force": factor,
        "idle": None if idle is None else len(idle.idle),
        "contraction": max((x for x in far if x is not None), default=None),
    }


def expected_intervals(plan: Plan, mounted: Mounted, muscle: PredictedMuscle | None) -> list[dict[str, Any]]:
    """The 95 % interval that the plan is expected to give for each coefficient, of a muscle known by coefficients.

    Empty for kinds of test that do not say it, and for muscles that are known by a surface, to which no straight line
    fits.
    """
    from pmabench.analysis.shared.samples import Noise

    kind = registry.all_kinds().get(plan.kind)
    if muscle is None or muscle.expected is None or kind is None or PART not in kind.parts:
        return []
    if muscle.numbers["law"] != "three-element":
        return []
    noise = options_of(muscle, mounted)["plant"]["noise"]
    expected = muscle.expected.model_dump(mode="json")
    return [vars(one) for one in load(kind.parts[PART])(plan.to_dict(), expected, Noise(**noise))]


def _intervals(found: list[dict[str, Any]]) -> Iterator[str]:
    """One line: the widest interval of each coefficient, as a share of its value."""
    widest: dict[str, float] = {}
    for one in found:
        if one["value"]:
            share = one["half"] / abs(one["value"])
            widest[one["symbol"]] = max(share, widest.get(one["symbol"], 0.0))
    if widest:
        shares = ", ".join(f"{symbol} {100 * share:.2g} %" for symbol, share in widest.items())
        yield cut(f"   intervals of at most {shares}")


def _slow(mounted: Mounted) -> bool:
    """Whether the muscle of a simulated bench is one with hysteresis."""
    plants = [device.options.get("plant") for device in mounted.bench.devices]
    return any(plant == "real" or (isinstance(plant, dict) and plant.get("law") == "real") for plant in plants)


def _result(outcome: Outcome, mounted: Mounted) -> dict[str, Any]:
    return {
        **fields(outcome, "status", "exit_code", "why"),
        "duration": outcome.bench_seconds,
        "measured": {name: {"lowest": low, "highest": high} for name, (low, high) in outcome.extremes.items()},
        "trials_failed": [index + 1 for index in outcome.trials_failed],
        "saturated": [
            {"trial": data["trial"] + 1, "share": data["result"]["saturated"]}
            for kind, _t, data in outcome.events
            if kind == "found" and data["result"].get("saturated", 0.0) > 0
        ],  # trials in which the commands of a law were at a limit, with the share of its samples
        "beyond": _beyond(outcome, mounted),
    }


def _beyond(outcome: Outcome, mounted: Mounted) -> list[str]:
    """Channels that came to an end of their range, where nobody knows how far they went."""
    found = []
    for channel in mounted.bench.channels:
        if channel.name not in outcome.extremes or "_command" in channel.name:
            continue
        (low, high), slack = outcome.extremes[channel.name], END * (channel.high - channel.low)
        if high >= channel.high - slack or (channel.low < 0 and low <= channel.low + slack):  # 0 is where many begin
            found.append(channel.name)
    return found


def findings_of(simulated: dict[str, Any]) -> list[str]:
    """A line for what saturates, and one for channels that leave their range."""
    lines = []
    if simulated["saturated"]:
        trials = sorted({one["trial"] for one in simulated["saturated"]})
        share = show(max(one["share"] for one in simulated["saturated"]), "ratio", 2)
        many = f"{len(trials)} trials, first {trials[0]}" if len(trials) > 1 else f"trial {trials[0]}"
        lines.append(f"commands are at a limit in {many}, for up to {share} of a trial")
    if simulated["beyond"]:
        lines.append(f"at the end of the range of the channel: {', '.join(simulated['beyond'])}")
    return lines


def report(
    plan: Plan, mounted: Mounted, simulated: dict[str, Any], findings: list[str], then: list[str]
) -> Iterator[str]:
    """At most 25 lines of 80 columns: how it ended, on which muscle, what to look at, peaks against limits, next."""
    length = in_words(simulated["duration"])
    yield cut(f"SIMULATED  {simulated['status'].upper()}  {plan.kind}: {len(plan.trials)} trials planned, {length}")
    yield from wrap(simulated["why"], WIDTH, initial_indent="   ", subsequent_indent="   ", max_lines=3)
    muscle = simulated["muscle"] or "that of the bench file"
    yield from wrap(f"muscle: {muscle}", WIDTH, subsequent_indent="   ", max_lines=3)
    for other in simulated["others"]:
        lifts = f"{other['idle']} trials cannot lift" if other["idle"] is not None else ""
        far = f"contracts up to {show(other['contraction'], 'length', 3)}" if other["contraction"] is not None else ""
        yield f"   with {other['force']:.2g} times the force: " + ", ".join(part for part in (lifts, far) if part)
    yield from _peaks(mounted, simulated)
    yield from _intervals(simulated["intervals"])
    for finding in findings[:MOST_FINDINGS]:
        yield from wrap(finding, WIDTH, initial_indent="!  ", subsequent_indent="   ", max_lines=2, placeholder=" …")
    if len(findings) > MOST_FINDINGS:
        more = len(findings) - MOST_FINDINGS
        yield f"   {more} more finding{'s' if more > 1 else ''}: -v"
    yield from then


def _peaks(mounted: Mounted, simulated: dict[str, Any]) -> Iterator[str]:
    trips: dict[str, float] = {}
    for trip in mounted.bench.trips:
        if trip.high is not None and trip.kind == "range":
            trips[trip.channel] = min(trip.high, trips.get(trip.channel, trip.high))
    shown = []
    pressures = [f"{PEAKS[0]}_{number}" for number in mounted.bench_file.muscles]
    for name in (*pressures, *PEAKS):
        if name in simulated["measured"]:
            quantity = CHANNEL_QUANTITY[name]
            top = show(simulated["measured"][name]["highest"], quantity, 3)
            limit = f" of {show(trips[name], quantity, 4)}" if name in trips else ""
            shown.append(f"{top}{limit}")
    if shown:
        yield from wrap(f"highest {', '.join(shown)}", WIDTH, initial_indent="   ", subsequent_indent="   ")


SYMBOLS = ("F_ce", "K", "B_c", "B_r")
FEWEST_POINTS = 2
FEWEST_FORCES = 8
"""Values of a surface from which its five factors are found."""


def newest_of(folder: Path, specimen: SpecimenFile, highest: float) -> PredictedMuscle | None:
    """The muscle of the newest analysis of this type and serial number on a real bench; None where there is none."""
    name = run_name(datetime.now(UTC), f"{specimen.type}-{specimen.serial}", "any", simulated=False).split("_")[1]
    found = [place for place in folder.glob(f"*_{name}_*") if "_SIMULATED_" not in place.name and place.is_dir()]
    for place in sorted(found, reverse=True):
        try:
            return of_analysis(place, specimen, highest)
        except (InvalidFile, UsageError):
            continue  # nothing that describes the muscle, or damaged: an older one may
    return None


def of_file(path: Path, specimen: SpecimenFile, highest: float) -> PredictedMuscle:
    """The muscle of a folder of analyses, or of a plant file, up to `highest` [Pa]."""
    if path.is_dir():
        return of_analysis(path, specimen, highest)
    return PredictedMuscle({**read_plant(path).numbers, "file": path.name}, None, f"plant file {path}")


def of_analysis(folder: Path, specimen: SpecimenFile, highest: float) -> PredictedMuscle:
    """The muscle of the analyses in a folder: a surface where one was fitted, else coefficients over pressure.

    Raises UsageError where none has enough values.
    """
    analyses = [read_analysis(place) for place in analyses_below(folder)]
    if not analyses:
        raise UsageError(f"{folder} holds no analysis; `pmabench process` makes one")
    mark = "SIMULATED " if any(analysis.simulated for analysis in analyses) else ""
    for analysis in analyses:
        if (found := _surface(analysis, specimen)) is not None:
            source = f"{mark}analysis {folder.name}: surface of {len(analysis.runs)} runs"
            return by_surface(found, specimen, highest, source)
    for analysis in analyses:
        if (expected := _expected(analysis, folder.name)) is not None:
            return as_expected(expected, specimen, highest, f"{mark}analysis {folder.name}: {analysis.kind}")
    needed = "F_ce, K, B_c and B_r at two pressures are needed, or a surface"
    raise UsageError(f"{folder} says too little of the muscle: {needed}")


def _expected(analysis: Analysis, name: str) -> ExpectedFile | None:
    """F_ce, K, B_c and B_r at each pressure at which F_ce and K are known; a damping that is not is the other one. Of a
    bent muscle they are the tangent where K is the slope.
    """
    table: dict[float, dict[str, float]] = {}
    friction = 0.0
    for e in analysis.estimates:
        if e.value is None or e.withheld or e.coordinate:
            continue
        if e.symbol == "F_c" and not e.at:
            friction = e.value
        elif e.symbol in SYMBOLS and set(e.at) == {"pressure"}:
            table.setdefault(e.at["pressure"], {}).setdefault(e.symbol, e.value)
    methods = [e.method for e in analysis.estimates if e.symbol == "K"]
    for pressure, (x, force) in slopes_of([analysis], methods[:1]).items():
        if {"F_ce", "K"} <= set(table.get(pressure, ())):
            table[pressure]["F_ce"] = force + table[pressure]["K"] * x
    points = []
    for pressure, row in sorted(table.items()):
        damping = [row[symbol] for symbol in ("B_c", "B_r") if symbol in row]
        if {"F_ce", "K"} <= set(row) and damping:
            known: dict[str, Any] = {"pressure": pressure, "F_ce": row["F_ce"], "K": row["K"]}
            points.append(ExpectedPoint.model_construct(**known, B_c=damping[0], B_r=damping[-1]))
    if len(points) < FEWEST_POINTS:
        return None
    return ExpectedFile.model_construct(source=f"analysis {name}", F_c=friction, points=points)


def _surface(analysis: Analysis, specimen: SpecimenFile) -> Surface | None:
    """The force surface nearest to the values of F at pressures and contractions, by least squares."""
    known = [e for e in analysis.estimates if e.symbol == "F" and e.value is not None and not e.withheld]
    known = [e for e in known if {"pressure", "contraction"} == set(e.at)]
    if len(known) < FEWEST_FORCES:
        return None
    places = [(e.at["pressure"], e.at["contraction"] / specimen.mounted.length, e.value or 0.0) for e in known]
    return nearest_surface(places)
