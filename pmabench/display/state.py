"""Present state of a run, as plain values from the events and samples in its folder.

Draws nothing. Samples are kept only for the curves and for trials that still need their line.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.display.channel import Channel, Setting
from pmabench.display.follow import Block, Follower, Kept, StreamTail
from pmabench.display.verdicts import TrialLine, Verdicts, read_expected
from pmabench.display.wording import event_text
from pmabench.protocol.plan import STEPS, Ask, Record, Step, WaitUntil
from pmabench.store.records import Array, Event, Flag, Flags, RunData, cut_trials, is_number

CURVES = 30.0
"""Shortest time range of the curves [s] ..."""
LONGEST_CURVES = 120.0
"""... which is extended to the beginning of the trial, up to this limit."""
LIVE = 2.0
"""How long values sent by the run are shown [s]."""
LATEST = 1.0
"""Longest wait for the samples of an ended trial before its line is made [s], if no more are ready to be read."""
LOG = 200
"""Number of notices kept."""
STARTS = {"pause": "goes-on", "prompt": "answer", "trial-begin": "trial-end"}
"""Kinds of event that stop the clock of the plan, and those that start it again."""


@dataclass(frozen=True)
class Notice:
    """A sentence for the log."""

    t: float | None
    text: str
    level: str
    """`info`, `doubt` or `fault`."""


@dataclass
class Trial:
    """A trial in progress."""

    index: int
    begin: float
    point: dict[str, float]
    repeat: int
    again: bool = False
    """A reference trial that is repeated because the run continues another one."""
    end: float | None = None
    seen: float = 0.0
    """Wall clock time at which its end was read [s]."""
    events: list[Event] = field(default_factory=list)
    at_limit: list[str] = field(default_factory=list)


class RunState:
    """All that is known of a run. `poll` reads new data; invalid data in the folder cause no errors."""

    def __init__(self, folder: Path, also: Callable[[StreamTail, Block], None] | None = None) -> None:
        """`also` is called with each block of samples, to keep them longer."""
        self.files = Follower(folder)
        self._also = also
        self.channels: dict[str, Channel] = {}
        self.settings: dict[str, Setting] = {}
        self.counts: dict[str, int] = dict.fromkeys(("gap", "late", "overrange"), 0)
        self.rows = 0
        self.phase = ""
        self.trial: Trial | None = None
        self.paused = False
        self.held: set[str] = set()
        """Active hold limits: no new commands are sent."""
        self.wanted: set[str] = set()
        """Keys of the operator that take effect at the end of the trial: `pause`, `repeat`."""
        self.prompt = ""
        """Present question to the operator; empty without one."""
        self.notices: deque[Notice] = deque(maxlen=LOG)
        self.lines: list[TrialLine] = []
        self.fresh: list[Notice | TrialLine] = []
        """New items since it was last emptied."""
        self.end_event: dict[str, Any] | None = None
        """Data of the `end` event."""
        self.progress: Progress | None = None
        self._verdicts = Verdicts()
        self._waiting: list[Trial] = []
        self.samples = Kept()
        self._t = 0.0
        self._live: tuple[float, dict[str, float]] | None = None
        self._fault = ""
        self._now = 0.0

    # -- events -------------------------------------------------------------------------------------------------------

    def poll(self, now: float | None = None) -> bool:
        """Read new data; `now` is the wall clock [s]. Returns whether more can be read at once."""
        self._now = now = time.time() if now is None else now
        before = self.files.there
        events = self.files.events()
        if self.files.there and not before:
            self._begin()
        for event in events:
            self._take(event)
        for stream, blocks in self.files.samples():
            for block in blocks:
                self._keep(stream, block)
        for text in self.files.notes():
            self.log(f"note: {text}")
        fault = self.files.journal.fault
        if fault and fault != self._fault:
            self._fault = fault
            self.log(f"the events cannot be read on: {fault}", "fault")
        self._judge()
        self._forget()
        self._ages(now)
        return self.files.behind

    def log(self, text: str, level: str = "info", t: float | None = None) -> None:
        """Add a sentence to the log."""
        notice = Notice(t, text, level)
        self.notices.append(notice)
        self.fresh.append(notice)

    def live(self, values: Mapping[str, float], now: float | None = None) -> None:
        """Values [SI] sent by the run while it records nothing."""
        known = {name: float(value) for name, value in values.items() if isinstance(value, int | float)}
        when = time.time() if now is None else now
        if self._live is None or when >= self._live[0]:
            self._live = when, known

    def _begin(self) -> None:
        """Read limits and channels from the bench, and expected coefficients from the specimen, once they exist."""
        bench = self.files.bench
        recorded = self.files.plan.get("record")
        for device in _list(bench.get("devices")):
            for item in _list(device.get("channels")):
                if not recorded or item.get("name") in recorded:
                    name, quantity = str(item.get("name")), str(item.get("quantity", ""))
                    self._channel(name, quantity, item.get("low"), item.get("high"))
        for trip in _list(bench.get("trips")):
            channel = self.channels.get(str(trip.get("channel")))
            if channel is not None and trip.get("kind", "range") == "range":
                channel.trip_low = _number(trip.get("low"), channel.trip_low)
                channel.trip_high = _number(trip.get("high"), channel.trip_high)
        for output in self._outputs():
            for name in (str(output.get("name")), f"{output.get('name')}_command"):
                if name in self.channels:
                    self.channels[name].command_low = _number(output.get("low"))
                    self.channels[name].command_high = _number(output.get("high"))
        self.progress = Progress(self.files.plan, self.before)
        self._verdicts = Verdicts(read_expected(self.files.folder))

    def _outputs(self) -> list[dict[str, Any]]:
        return [o for device in _list(self.files.bench.get("devices")) for o in _list(device.get("outputs"))]

    def _channel(self, name: str, quantity: str, low: Any, high: Any) -> Channel:
        ends = _number(low, -np.inf), _number(high, np.inf)
        return self.channels.setdefault(name, Channel(name, quantity, ends[0] or 0.0, ends[1] or 0.0))

    def _take(self, event: Event) -> None:
        """Update the state with one event."""
        self._t = max(self._t, event.t)
        data, kind = event.data, event.kind
        if self.progress is not None:
            self.progress.take(event)
        if "phase" in data and kind in ("command", "prompt", "found"):
            self.phase = str(data["phase"])
        if kind == "command":
            self._command(event)
        elif kind == "live" and isinstance(data.get("values"), dict):
            self.live(data["values"], self.files.journal.written)
        elif kind == "end":
            self.end_event = dict(data)
        self._take_of_operator(kind, data)
        self._take_of_trial(event)
        if (sentence := event_text(event)) is not None:
            self.log(*sentence, event.t)

    def _take_of_operator(self, kind: str, data: Mapping[str, Any]) -> None:
        """Update question, waiting keys, holds and pause."""
        if kind == "prompt":
            self.prompt = str(data.get("text", ""))
        elif kind in ("answer", "trip", "ended-early", "end"):
            self.prompt = ""
        elif kind == "key":
            (self.wanted.add if data.get("on") else self.wanted.discard)(str(data.get("key")))
        elif kind == "warning" and data.get("action") in ("hold", "over"):
            (self.held.add if data["action"] == "hold" else self.held.discard)(str(data.get("limit", "")))
        elif kind in ("pause", "goes-on"):
            self.paused = kind == "pause"
            self.wanted.discard("pause")
        elif kind == "trial-end":
            self.wanted.discard("repeat")

    def _take_of_trial(self, event: Event) -> None:
        """Update the current trial: beginning, end, and events in it."""
        data = event.data
        if event.kind == "trial-begin" and isinstance(data.get("trial"), int):
            point = {str(k): float(v) for k, v in (data.get("point") or {}).items() if isinstance(v, int | float)}
            self._close_trial(event)
            self.trial = Trial(data["trial"], event.t, point, int(data.get("repeat") or 0), bool(data.get("again")))
        if self.trial is None:
            return
        if event.kind == "limit-reached":
            self.trial.at_limit.append(str(data.get("reason", "limit reached")))
        self.trial.events.append(event)
        if event.kind == "trial-end":
            self._close_trial(event)

    def _command(self, event: Event) -> None:
        output = str(event.data.get("output", ""))
        quantity = next((str(o.get("quantity", "")) for o in self._outputs() if o.get("name") == output), output)
        if (value := _number(event.data.get("value"))) is not None:
            self.settings[output] = Setting(output, quantity, str(event.data.get("type", "set")), value, event.data)

    def _close_trial(self, event: Event) -> None:
        if self.trial is not None:
            self.trial.end, self.trial.seen = event.t, self._now
            self._waiting.append(self.trial)
            self.trial = None

    # -- samples ------------------------------------------------------------------------------------------------------

    def _keep(self, stream: StreamTail, block: Block) -> None:
        self.rows += len(block.t)
        self._t = max(self._t, float(block.t[-1]))
        for name, values in block.values.items():
            info = stream.infos[name]
            channel = self._channel(name, info.quantity, info.low, info.high)
            channel.stream = stream.name
            good = values[np.isfinite(values)]
            ends = (float(good.min()), float(good.max())) if len(good) else (np.nan, np.nan)
            channel.show(float(values[-1]), *ends)
        seen = int(np.bitwise_or.reduce(block.flags)) if len(block.flags) else 0
        for flag in Flag:
            if flag and seen & flag:
                count = int(np.count_nonzero(block.flags & np.uint16(flag)))
                name = str(flag.name).lower().replace("_", " ")
                self.counts[name] = self.counts.get(name, 0) + count
        self.samples.add(stream.name, block)
        if self._also is not None:
            self._also(stream, block)

    def _judge(self) -> None:
        """Make the line of each ended trial, once all its samples were read."""
        while self._waiting:
            trial = self._waiting[0]
            late = self._now - trial.seen > LATEST and not self.files.behind
            if trial.end is None or not (self._complete(trial.end) or late):
                return
            self._waiting.pop(0)
            if (line := self._line(trial)) is not None:
                self.lines = [*(before for before in self.lines if not line.replaces(before)), line]
                self.fresh.append(line)

    def _complete(self, end: float) -> bool:
        """Whether all samples up to a time were read: the run is closed, or every stream has reached it."""
        if self.files.behind:
            return self.samples.reached >= end
        slowest = min((stream.rate for stream in self.files.streams.values() if stream.rate), default=np.inf)
        return self.status != "running" or self.samples.reached >= end - 2.0 / slowest

    def _line(self, trial: Trial) -> TrialLine | None:
        t, channels, flags, rate = self.between(trial.begin, np.inf if trial.end is None else trial.end)
        infos = {name: info for stream in self.files.streams.values() for name, info in stream.infos.items()}
        manifest = self.files.manifest
        cut = cut_trials(str(manifest.get("id")), trial.events, t, channels, flags, np.inf)
        run = RunData(
            id=str(manifest.get("id")),
            path=str(self.files.folder),
            kind=self.kind,
            status="running",
            simulated=self.simulated,
            manifest=manifest,
            plan=self.files.plan,
            events=tuple(trial.events),
            channels=infos,
            rate=rate,
            trials=cut,
        )
        return self._verdicts.judge(run, cut[0], trial.at_limit) if cut else None

    def between(self, begin: float, end: float) -> tuple[Array, dict[str, Array], Flags, float]:
        """Samples of all streams on the times of one, as in `Kept.between`."""
        return self.samples.between(begin, end, {name: stream.rate for name, stream in self.files.streams.items()})

    def _forget(self) -> None:
        """Drop samples that are no longer needed."""
        begun = [trial.begin for trial in (*self._waiting, self.trial) if trial is not None]
        self.samples.forget(min([self._t - LONGEST_CURVES, *begun]) - 1.0)

    def _ages(self, now: float) -> None:
        """Age of each newest value from the time of its file; values sent by the run are newer."""
        for channel in self.channels.values():
            stream = self.files.streams.get(channel.stream)
            channel.age = max(0.0, now - stream.written) if stream is not None and channel.value is not None else None
        if self._live is not None and now - self._live[0] < LIVE and self.trial is None:
            for name, value in self._live[1].items():
                if name in self.channels:
                    self.channels[name].show(value, value, value)
                    self.channels[name].age = max(0.0, now - self._live[0])

    # -- values for display -------------------------------------------------------------------------------------------

    def span(self) -> tuple[float, float]:
        """Time range of the curves [s]: the trial so far, at least the last half minute."""
        end = self.samples.newest
        begin = self.trial.begin if self.trial is not None else end
        return min(end - CURVES, max(begin, end - LONGEST_CURVES)), end

    @property
    def kind(self) -> str:
        """Kind of protocol."""
        return str(self.files.manifest.get("kind", ""))

    @property
    def simulated(self) -> bool:
        """Whether any device is simulated."""
        return bool(self.files.manifest.get("simulated"))

    @property
    def specimen(self) -> str:
        """Type and serial number."""
        specimen = self.files.manifest.get("specimen")
        if isinstance(specimen, dict):
            return f"{specimen.get('type', '')} {specimen.get('serial', '')}".strip()
        return str(specimen or "")

    @property
    def trials(self) -> int:
        """Number of planned trials."""
        return int(self.files.manifest.get("trials_planned") or 0)

    @property
    def done(self) -> int:
        """Number of completed trials, in this run and in those that it continues."""
        return len(self.before | {line.index for line in self.lines if line.ended and not line.again})

    @property
    def before(self) -> frozenset[int]:
        """Trials that were finished in the runs that this one continues."""
        done = _dict(self.files.manifest.get("continues")).get("trials_done")
        return frozenset(index for index in done if isinstance(index, int)) if isinstance(done, list) else frozenset()

    @property
    def status(self) -> str:
        """`waiting`, `running`, or how the run ended."""
        status = self.files.status
        if status == "running" and self.end_event is not None:
            return str(self.end_event.get("status", status))
        return status

    @property
    def ended(self) -> bool:
        """Whether no more data will come."""
        closed = self.files.seal is not None or self.files.status == "interrupted"
        return self.files.there and closed and not self.files.behind and not self._waiting

    @property
    def why(self) -> str:
        """Why the run ended as it did."""
        end = self.files.seal or self.end_event or {}
        if self.status == "interrupted":
            return "the program that wrote it died"
        return str(end.get("why") or "")

    @property
    def vent(self) -> str:
        """Result of the vent at the end, such as `confirmed`; empty before."""
        end = (self.files.seal or {}).get("end") or self.end_event
        return str(_dict(_dict(end).get("vent")).get("result", ""))

    @property
    def t(self) -> float:
        """Bench time [s]; in real time it also advances while nothing is written."""
        written = max([s.written for s in self.files.streams.values()] + [self.files.journal.written], default=0.0)
        if self.status == "running" and self.files.bench.get("realtime") and written:
            return self._t + max(0.0, self._now - written)
        return self._t


def _dict(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[dict[str, Any]]:
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _number(value: Any, otherwise: float | None = None) -> float | None:
    return float(value) if is_number(value) else otherwise


class Progress:
    """The place in a plan of the last beginning or end of a trial, and the time since, not beyond the next.

    While a question is open, in a pause, and in a reference trial that is done again, the clock of the plan stands.
    """

    def __init__(self, plan: Mapping[str, Any], before: Collection[int] = ()) -> None:
        """A run that goes on stands at the first trial that was not finished `before`."""
        steps: list[Step] = []
        with suppress(KeyError, TypeError, AttributeError):
            for item in plan.get("steps") or ():
                fields = dict(item)
                steps.append(STEPS[fields.pop("step")](**fields))
        usual = (s.shortest() if isinstance(s, Ask | WaitUntil) else s.longest() for s in steps)
        until = list(accumulate((max(0.0, float(seconds)) for seconds in usual), initial=0.0))
        self.length = until[-1]
        """Planned duration [s] if every wait ends at once and every search takes its longest time."""
        marks = [(s.on, s.trial, at) for s, at in zip(steps, until, strict=False) if isinstance(s, Record)]
        marks = [mark for mark in marks if mark[1] is not None]
        ends = [*(at for _, _, at in marks), self.length]
        self._places = {(on, trial): (at, ends[n + 1]) for n, (on, trial, at) in enumerate(marks)}
        start = next((place for (on, trial), place in self._places.items() if on and trial not in before), None)
        self._here = start if before and start is not None else (0.0, ends[0])
        """Time of the plan [s] at the last mark, and at the next."""
        self._since: float | None = None
        self._stopped: tuple[float, str] | None = None
        """Since when the clock stands [s], and the kind of event that starts it again."""

    def take(self, event: Event) -> None:
        """Go to the mark that an event is, or stop and start the clock."""
        kind = event.kind
        self._since = event.t if self._since is None else self._since
        if self._stopped is not None:
            begin, end = self._stopped
            if kind not in (end, "trial-end"):
                return
            self._since, self._stopped = self._since + event.t - begin, None
            if kind == end:
                return
        elif kind in ("pause", "prompt") or (kind == "trial-begin" and event.data.get("again")):
            self._stopped = event.t, STARTS[kind]
            return
        if kind in ("trial-begin", "trial-end"):
            place = self._places.get((kind == "trial-begin", event.data.get("trial")))
            self._here, self._since = (place, event.t) if place is not None else (self._here, self._since)

    def done(self, t: float) -> float:
        """Fraction of the plan that is done at `t` [s]."""
        return self._behind(t) / self.length if self.length > 0 else 0.0

    def _behind(self, t: float) -> float:
        now = t if self._stopped is None else self._stopped[0]
        since = 0.0 if self._since is None else max(0.0, now - self._since)
        return min(self._here[0] + since, self._here[1])

    def left(self, t: float) -> float | None:
        """What the plan has left at `t` [s], without the operator's time; None if unknown."""
        return self.length - self._behind(t) if self.length else None
