"""`pmabench recalibrate`: the same raw samples with other calibrations or moved in time, and what that changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError
from pmabench.base.system import user_name
from pmabench.cli.common import Ui, common, fields, read_quantity
from pmabench.cli.names import PATH, RunFolder

if TYPE_CHECKING:
    from pmabench.analysis.verdict.comparison import Change
    from pmabench.store.analyses.results import Analysis
    from pmabench.store.reader import NewScale, Recalibration
    from pmabench.store.records import RunData

SCALE = ("calibration", "slope", "offset", "offset_uncertainty", "gain_uncertainty")
"""What a channel says of its scale."""


@click.command(name="recalibrate")
@click.argument("runs", nargs=-1, required=True, type=RunFolder(), metavar="RUN...")
@click.option(
    "--calibration",
    "calibrations",
    multiple=True,
    metavar="[CHANNEL=]FILE",
    help="A calibration file; the channel where several measure its quantity.",
)
@click.option(
    "--skew",
    "skews",
    multiple=True,
    metavar="CHANNEL=TIME",
    help='How much older the values of a channel are than their time stamps, for instance "pressure=12 ms".',
)
@click.option("--because", default="", metavar="TEXT", help="Why; the new analyses and their report say so.")
@click.option("--operator", default="", help="Who says so; the login name if not given.")
@click.option("--out", type=PATH, help="Folder of the new analyses, which must not exist.")
@common
def command(
    ui: Ui,
    runs: tuple[Path, ...],
    calibrations: tuple[str, ...],
    skews: tuple[str, ...],
    because: str,
    operator: str,
    out: Path | None,
) -> None:
    """Process RUNS again from their raw samples with other calibrations, and say what becomes of each coefficient.

    The runs and what was made of them before stay as they are; the new analyses get a folder of their own.
    """
    from pmabench.analysis.verdict.comparison import changes
    from pmabench.cli.process import write
    from pmabench.cli.sources import campaign_folder, load_runs, without_analyses
    from pmabench.kinds.reduce import reduce_runs
    from pmabench.kinds.registry import loops
    from pmabench.report.other_pages import print_changes
    from pmabench.store.chain import open_chains
    from pmabench.store.reader import refuse_loops

    if not calibrations and not skews:
        raise UsageError("nothing is to be changed: give --calibration FILE or --skew CHANNEL=TIME")
    ui.begin("processing the runs twice")
    given = without_analyses(ui, runs)
    recorded = load_runs(given)
    anew = _asked(recorded, calibrations, skews)
    if anew.scales:
        refuse_loops(recorded, loops())
    changed = open_chains(given, anew)
    channels = _described(recorded, changed, anew)
    before = reduce_runs(recorded)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    who = {"at": now, "operator": operator or user_name(), "because": because.strip()}
    after = reduce_runs(changed)
    found = changes(before, after)
    after = [_marked(analysis, channels, found, who) for analysis in after]
    first = next(run for run in recorded if Path(run.path).resolve() == given[0].resolve())
    folder = out or _free(campaign_folder(Path(first.path).resolve().parent) / "analyses" / f"{first.id}-recalibrated")
    if folder.exists():
        raise UsageError(f"{folder} exists; give --out the name of a new folder")
    folders = write(after, changed, folder)
    data: dict[str, Any] = {
        "schema": "pmabench.recalibrate/1",
        "runs": [run.id for run in recorded],
        "recalibration": who,
        "channels": channels,
        "folders": [str(path) for path in folders],
        "changes": [change.to_dict() for change in found],
    }

    def human() -> None:
        for channel in channels:
            click.echo(channel["sentence"])
        print_changes(found, ui.console())
        click.echo("\n".join(str(path) for path in folders))

    ui.result(data, human, [str(path) for path in folders])


def _asked(runs: Sequence[RunData], calibrations: Sequence[str], skews: Sequence[str]) -> Recalibration:
    from pmabench.store.reader import LONGEST, Recalibration, channel_for

    scales: dict[str, NewScale] = {}
    for text in calibrations:
        name, file = _named(text, runs)
        scale = _scale(file)
        channel = channel_for(runs, scale.quantity, name)
        if channel in scales:
            raise UsageError(f"two calibrations are given for {channel}")
        scales[channel] = scale
    late: dict[str, float] = {}
    for text in skews:
        name, equals, value = text.partition("=")
        known = sorted({channel for run in runs for channel in run.channels})
        if not equals or name not in known:
            raise UsageError(f'--skew "{text}" is not CHANNEL=TIME; channels here: {", ".join(known)}')
        late[name] = read_quantity(f"--skew {name}", value, "time")
        if abs(late[name]) > LONGEST:
            raise UsageError(f"--skew {name}: {value} is more than {LONGEST:g} s")
    return Recalibration(scales, late)


def _named(text: str, runs: Sequence[RunData]) -> tuple[str, Path]:
    """Channel (empty: not said) and file; a file whose name has an `=` in it is meant as it is."""
    name, equals, file = text.partition("=")
    if equals and not Path(text).exists() and (name.isidentifier() or any(name in run.channels for run in runs)):
        return name, Path(file)
    return "", Path(text)


def _scale(file: Path) -> NewScale:
    from pmabench.bench.channels import read_calibration
    from pmabench.bench.files.specimen import CalibrationFile
    from pmabench.files.document import read_document, validate
    from pmabench.store.reader import NewScale

    quantity = validate(CalibrationFile, read_document(file)).quantity
    read = read_calibration(file, quantity)
    return NewScale(quantity, read.raw_unit, read.scale.slope, read.scale.offset, asdict(read.record))


def _described(before: Sequence[RunData], after: Sequence[RunData], anew: Recalibration) -> list[dict[str, Any]]:
    """Of each changed channel: its scale and calibration before and after, and a sentence for people."""
    channels = []
    for name, late in anew.late.items():
        sentence = f"{name}: its values are taken as {1e3 * late:.6g} ms older than their time stamps"
        channels.append({"channel": name, "late": late, "sentence": sentence})
    for name in anew.scales:
        scales: list[dict[str, Any]] = []
        for old, new in zip(before, after, strict=True):
            if name in old.channels:
                was, is_ = (fields(run.channels[name], *SCALE) for run in (old, new))
                scales.append({"run": old.id, "before": was, "after": is_})
        names = list(dict.fromkeys(str(scale["before"]["calibration"]) or "no calibration" for scale in scales))
        sentence = f"{name}: calibration {anew.scales[name].calibration.get('id')} instead of {', '.join(names)}"
        record = anew.scales[name].calibration
        about = {key: record.get(key) for key in ("id", "reference", "date", "sha256")}
        channels.append({"channel": name, "calibration": about, "scales": scales, "sentence": sentence})
    return channels


def _marked(
    analysis: Analysis, channels: Sequence[dict[str, Any]], found: Sequence[Change], who: Mapping[str, str]
) -> Analysis:
    """The analysis with what was changed, who asked for it, when and why, and the changes of its coefficients."""
    from pmabench.store.analyses.results import Finding

    said = [Finding("note", f"recalibrated after the fact, {channel['sentence']}") for channel in channels]
    mine = [one.to_dict() for one in found if (one.kind, one.runs) == (analysis.kind, analysis.runs)]
    facts = {"recalibrated": [dict(channel) for channel in channels], "recalibration": {**who, "changes": mine}}
    return replace(analysis, findings=(*said, *analysis.findings), facts={**analysis.facts, **facts})


def _free(folder: Path) -> Path:
    others = (folder.with_name(f"{folder.name}-{number}") for number in count(2))
    return next(place for place in chain([folder], others) if not place.exists())
