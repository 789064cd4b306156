"""The safe state: the declared actions in their order, advanced step by step, never cancelled."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from math import inf, nan

from pmabench.base.errors import Busy, NotSent
from pmabench.base.quantities import CHANNEL_QUANTITY, QUANTITIES
from pmabench.bench.interface import SafeAction
from pmabench.guard.owner import PATIENCE, Call

AT_ONCE = ("set", "stop", "open", "close")
LOOKS = ("confirm", "rest")
"""Actions that only measure: that a value is low, or (added by the guard) that a motion has ended."""
NO_EFFECT = 0.7
"""A high value that falls by less than 2 % of its maximum within this time [s] shows no effect of the commands."""
ANSWERS = 5 * PATIENCE
"""Longest wait for an answer whether a command is held [s].

Without an answer the command counts as not carried out; over the second connection, which may hang, as sent.
"""
REPEAT = 0.5
"""While a confirmation is waited for, the commands are repeated at this interval [s]; they are absolute."""
RETRY = 0.1
"""Interval for repeating a command that was not acknowledged [s], also during other waits."""
AWAY = 0.8
"""A device that acknowledges no command for this time [s] is opened again: some connections do not recover."""
STAYS = 0.5
"""All values must stay low for this time [s] after the last command, as a valve may open with a delay."""
LINGERS = 3.0
"""A command without an answer may be carried out up to this much later [s]; safe commands are repeated until then."""
TWICE = 2
"""Count from which it matters: one lost answer is no lost device, and one false reading no empty muscle."""
UNANSWERED = f"a command was not answered; after {LINGERS:g} s nobody looks whether it comes"
LEFT = "what it holds is not known, and may be what it held before"
EMPTIER = 20e3
"""A ramp this far [Pa] above the measured pressure, and above twice its value, would fill the muscle.

Also the least deviation with which a pressure does not follow its command; 10 % of its initial value if that is more.
"""


@dataclass(frozen=True)
class Vent:
    """Result of the safe state: `confirmed`, `commanded` (not confirmed) or `failed`; and outcome of each action."""

    result: str
    actions: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """Whether measured values show that the bench is safe."""
        return self.result == "confirmed"


@dataclass
class _Sent:
    action: SafeAction
    call: Call
    since: float
    rescue: Call | None = None
    look: Call | None = None
    """Question whether the device holds the command; its result is an empty text if so, else a sentence."""

    def said(self) -> str | None:
        """Answer of the device whether it holds the command; None if there is none (yet)."""
        look = self.look
        return (look.result or "") if look is not None and look.done.is_set() and look.error is None else None

    def acknowledged(self) -> bool:
        """Whether the device acknowledged it, over either connection."""
        return any(call is not None and call.done.is_set() and call.error is None for call in (self.call, self.rescue))


@dataclass
class _Watched:
    """Recent history of a value that must be low (`confirm`) or constant (`rest`)."""

    action: SafeAction
    floor: float
    blind: bool = False
    """Whether it may stand still at its value, and so confirms nothing."""
    value: float | None = None
    seen: float = -inf
    """When the newest value came [s]."""
    since: float | None = None
    """Start of the present series of good values [s]."""
    bad: float | None = None
    """Start of the present series of bad values [s]; `most` is their maximum."""
    most: float = -inf
    falls: bool = False
    place: float = nan

    def look(self, value: float, now: float) -> bool:
        """Note a new value; returns whether it turned bad after good ones."""
        before, bound = self.since, self.action.value
        rest = self.action.do == "rest"
        good = abs(value - self.place) <= bound if rest else self.floor < value < bound
        self.value, self.seen = value, now
        if good:
            self.since, self.bad, self.most = None if self.blind else now if before is None else before, None, -inf
        elif value != value:
            self.since = None  # a failed sensor (NaN) is no high value
        else:
            self.since, self.bad = None, now if self.bad is None else self.bad
            self.most, self.place = max(self.most, value), value
            self.falls = not rest and value < 0.98 * self.most
        return before is not None and not good

    def lasts(self, now: float, late: float) -> bool:
        """Whether it has been good for `STAYS`, counted from `late` [s], and values still arrive."""
        return self.since is not None and self.seen - max(self.since, late) >= STAYS and now - self.seen <= STAYS

    def unmoved(self, now: float) -> bool:
        """Whether the commands show no effect on the value."""
        return self.bad is not None and now - self.bad >= NO_EFFECT and not self.falls

    def outcome(self, good: bool, now: float) -> str:
        """What is said of it at the end."""
        action, value = self.action, self.value
        name, within = f"{action.do} {action.target}", f"within {action.within:g} s"
        ago = f" {now - self.seen:.2g} s ago" * (now - self.seen > STAYS)
        measured = "nothing measured" if value is None or value != value else _shown(action, value) + ago
        if action.do == "rest":
            return f"{name}: {measured}, {'at rest' if good else f'and not at rest {within}'}"
        if good:
            return f"{name}: {measured}, below {_shown(action)}"
        if value is not None and value < action.value:
            wrong = ", and not for long" if self.since is not None else ", which a broken wire reads"
            measured += ", by a gauge that has not moved: it confirms nothing" if self.blind else wrong
        return f"{name}: {measured}, not below {_shown(action)} {within}"


@dataclass
class _Way:
    """Distance of a pressure from its safe value, or of a motion from its target, during a ramp or a hold."""

    since: float
    """When it last came nearer [s]."""
    farthest: float = -inf
    nearest: float = inf
    away: int = 0

    def fails(self, far: float, expected: float, slack: float, now: float) -> bool:
        """Whether it stays where it is, or moves away, although the commands should bring it nearer."""
        self.farthest = max(self.farthest, expected) if self.nearest < inf else max(far, expected)
        if far <= expected + slack or far < 0.98 * self.nearest:
            self.nearest, self.since = far, now
        self.away = self.away + 1 if far > self.farthest + 2 * slack else 0
        return self.away > TWICE or now - self.since >= NO_EFFECT


class SafeState:
    """One pass through the actions.

    `begin` starts an action (the result of a ramp is its duration [s], 0 if it ends at once), `rescue` sends it
    over a second connection, and `look` asks whether a command is held (None: cannot be asked); all return at once.
    Consecutive commands are sent together; `ramp`, `hold` and `confirm` are waited for until done or until their time
    is over, and at the end all measured values must be good at the same time. A value at or below its entry in `floors`
    [SI] confirms nothing, nor does any within `LINGERS` after `unanswered` [s]. `motions` are moving outputs: `hurry`
    stops them where they are, while a pressure is released. `expected` returns where an output is commanded to be now,
    and the allowed deviation of the measured value [SI]; `compare` asks the devices that confirm whether they still
    measure as they did when the bench was armed. `blind` is a channel that may stand still at a low value.
    """

    def __init__(
        self,
        actions: tuple[SafeAction, ...],
        begin: Callable[[SafeAction], Call],
        rescue: Callable[[SafeAction], Call | None],
        look: Callable[[SafeAction], Call | None],
        now: float,
        floors: Mapping[str, float],
        unanswered: Callable[[], float],
        motions: Collection[str],
        expected: Callable[[str], tuple[float, float]],
        compare: Callable[[], list[Call]],
        blind: Collection[str] = (),
    ) -> None:
        self._compare, self._blind = compare, {*blind}
        self._asked: list[Call] | None = None
        """Questions whether the devices that confirm still measure as they did when armed."""
        self._floors, self._motions, self._unanswered, self._expected = floors, motions, unanswered, expected
        self._ends: dict[str, float] = {}
        """Target of each motion on a ramp that has not been stopped [SI]."""
        self._ways: dict[str, _Way] = {}
        self._todo = list(actions)
        self._finals = [action for action in actions if action.do in LOOKS]
        while self._todo and self._todo[-1].do in LOOKS:
            self._todo.pop()
        self._begin, self._rescue, self._look = begin, rescue, look
        self._sent: list[_Sent] = []
        self._begun = self._since = self._repeated = now
        self._longest = inf
        """Longest wait for confirmations [s], if the deadlines that the bench declares are not to be waited for."""
        self._ramp: _Sent | None = None
        self._doubts = self._emptier = 0
        """Consecutive missing answers of a ramp's device, and measurements of a muscle emptier than its ramp."""
        self._watched: list[_Watched] = []
        self.outcome: list[str] = []
        self.faults: list[str] = []
        """Faults, even if all values are low at the end; the bench must be inspected before the next run."""
        self.missing: dict[str, float] = {}
        """Targets that have not acknowledged their command, and since when [s]."""
        self.away: set[str] = set()
        """Those of them whose device must be opened again."""
        self.refusing: set[str] = set()
        """Targets whose device answers, but refused the command, holds something else, or stays busy."""
        self.unmoved: set[str] = set()
        """Channels that have not fallen, or not come to rest, after all commands."""
        self.commands: list[SafeAction] = []
        """Commands to be repeated; a ramp as its end value."""
        self._again: dict[SafeAction, _Sent] = {}
        """The last repeat of each command, with its call."""
        self._repeats: list[_Sent] = []
        """Repeats in progress."""
        self._settled = -inf
        """When a target that was missing or refusing first held its command [s]."""
        self.vent: Vent | None = None
        """Result, once it is over."""

    def _at_once(self, action: SafeAction) -> SafeAction:
        """Command that replaces a ramp which must not continue: stop for a motion, so that it is not sped up."""
        return replace(action, do="stop" if action.target in self._motions else "set")

    def hurry(self, how: int) -> None:
        """Skip all waits: send every remaining command now, then wait for confirmations only.

        With `how` above 1 not for long either: the wait for them ends as soon as no late command can come any more.
        """
        self._longest = LINGERS if how > 1 and any(a.within > LINGERS for a in self._finals) else self._longest
        left = (action for action in self._todo if action.do not in {"hold", *LOOKS})
        self._todo = [self._at_once(action) if action.do == "ramp" else action for action in left]

    def step(self, now: float, latest: Mapping[str, float]) -> bool:
        """Do what can be done now, with the `latest` measured values [SI]; returns whether it is over."""
        self._gather(now)
        self._blind -= {a.target for a in self._finals if latest.get(a.target, -inf) >= a.value}
        for command, sent in list(self._again.items()):
            if command.target in self.unsettled and now - sent.since >= RETRY:
                self._send_again(command, now)
        self._check_ways(now, latest)
        while self._todo and self._advance(self._todo[0], now, latest):
            self._go_on(now)
            self._gather(now)
        if self.vent is not None or self._todo:
            return self.vent is not None
        over = self._looked_at(self._finals, now, latest)
        if self._asked is None and not self._sent:
            self._asked = self._compare()
        asked = self._asked or []
        heard = all(call.done.is_set() for call in asked) or now - self._since >= ANSWERS
        if over and not self._sent and heard:
            good = [watched.lasts(now, self._late()) for watched in self._watched]
            self.outcome += [watched.outcome(ok, now) for watched, ok in zip(self._watched, good, strict=True)]
            self.outcome += [UNANSWERED] * (self._unanswered() > self._begun - LINGERS)
            self.outcome += (differs := [f"{call.result}; its values confirm nothing" for call in asked if call.result])
            low = bool(good) and all(good) and not differs
            self.outcome += [f"{name}: {LEFT}" for name in sorted(self.unsettled) if low]
            self.outcome += [f"waited {now - self._since:.3g} s, ended on request"] * (not low and self._longest < inf)
            result = "failed" if self.faults and not low else "commanded"
            self.vent = Vent("confirmed" if low and not self.unsettled else result, tuple(self.outcome))
        return self.vent is not None

    @property
    def waits(self) -> bool:
        """Whether a ramp or a hold is in progress."""
        return bool(self._todo) and self._todo[0].do in {"ramp", "hold"}

    def _late(self) -> float:
        """Time from which no earlier command can take effect any more [s]."""
        return max(self._unanswered() + LINGERS, self._settled)

    @property
    def unsettled(self) -> set[str]:
        """Targets that have not acknowledged a safe command, or do not hold it."""
        return self.missing.keys() | self.refusing

    def _check_ways(self, now: float, latest: Mapping[str, float]) -> None:
        """End the ramp of a pressure that does not follow, or a hold, and stop a motion that does not go to its place.

        A pressure that does not fall after that either shows no effect of the commands.
        """
        for name, value in latest.items():
            end = self._ends.get(name)
            if value != value or (end is None and (name in self._motions or not self.waits)):
                continue
            expected, slack = self._expected(name)
            far, near = (abs(value - end), abs(expected - end)) if end is not None else (value, expected)
            if self._ways.setdefault(name, _Way(now)).fails(far, near, slack, now):
                del self._ways[name]
                what = f"{name}: does not follow what the safe state commands"
                if what in self.faults:
                    self.unmoved.add(name)
                    continue
                self.fault(what)
                self._end_way(name, now)

    def fault(self, text: str) -> None:
        """Record a fault."""
        self.outcome.append(text)
        self.faults.append(text)

    def _go_on(self, now: float) -> None:
        """Advance to the next action."""
        self._todo.pop(0)
        self._since = self._repeated = now
        self._ramp, self._watched = None, []

    def _end_way(self, name: str, now: float) -> None:
        """Stop a motion, or send what is left for a pressure now, and wait for it no more; others keep their ramps."""
        left = [action for action in self._todo if action.target == name and action.do in {"ramp", "set"}]
        if self._todo and (self._todo[0] in left or (self._todo[0].do == "hold" and name not in self._motions)):
            self._go_on(now)
        self._todo = [action for action in self._todo if action not in left]
        for action in [SafeAction("stop", name, 0.0, PATIENCE)] if name in self._motions else left:
            self._send(self._at_once(action), now)

    def _advance(self, action: SafeAction, now: float, latest: Mapping[str, float]) -> bool:
        """Carry out an action of the list; returns whether the next one may begin."""
        if action.do in LOOKS:
            return self._looked_at([action], now, latest)
        if action.do in AT_ONCE:
            self._send(action, now)
            return True
        if action.do == "ramp" and self._ramp is None:
            self._ramp = self._send(action, now)
            if action.target in self._motions:
                self._ends[action.target] = action.value
        if self._ramp is None:
            return now - self._since >= action.within
        lasts, failed = self._ramp.call.result, self._ramp.call.error is not None
        if lasts and self._astray(self._ramp, now, latest, action.value + action.rate * (self._since + lasts - now)):
            self._todo[0] = self._at_once(action)
            return self._advance(self._todo[0], now, latest)
        over = failed or now - self._since >= min(action.within, action.within if lasts is None else lasts)
        if over and (failed or action.target not in self._motions):
            self.commands.append(self._at_once(action))
        return over

    def _send(self, action: SafeAction, now: float) -> _Sent:
        sent = self._command(action, now)
        self._sent.append(sent)
        self.commands += [action] * (action.do in AT_ONCE)
        return sent

    def _command(self, action: SafeAction, now: float) -> _Sent:
        if action.do == "stop":
            self._ends.pop(action.target, None)
        return _Sent(action, self._begin(action), now)

    def _astray(self, sent: _Sent, now: float, latest: Mapping[str, float], expected: float) -> bool:
        """Whether a ramp must end: its device is lost or was reset, and the ramp would fill the muscle again."""
        if sent.action.target in self._motions:
            return False
        said = "" if sent.look is None else sent.said()
        if now - self._repeated >= REPEAT:
            self._repeated, self._doubts = now, 0 if said is not None else self._doubts + 1
            sent.look = self._look(sent.action)
        value = latest.get(sent.action.target)
        if value is not None:
            self._emptier = self._emptier + 1 if value < min(expected / 2, expected - EMPTIER) else 0
        return self._emptier >= TWICE or bool(said) or self._doubts >= TWICE

    def _looked_at(self, actions: list[SafeAction], now: float, latest: Mapping[str, float]) -> bool:
        """Whether all values are good at the same time, or their time is over; repeats the commands until then."""
        if [watched.action for watched in self._watched] != actions:
            self._watched = [_Watched(action, self._floors.get(action.target, -inf)) for action in actions]
        late, back = self._late(), False
        for watched in self._watched:
            value, watched.blind = latest.get(watched.action.target), watched.action.target in self._blind
            back = (value is not None and watched.look(value, now)) or back
            watched.since = None if self._sent else watched.since
            if watched.unmoved(now) and watched.action.target in self._ends:
                self._end_way(watched.action.target, now)
                watched.bad = None
            elif watched.unmoved(now):
                self.unmoved.add(watched.action.target)
        since = [watched.since for watched in self._watched if watched.since is not None]
        whole = len(since) == len(self._watched) and not self.unsettled
        until = self._since + min(self._longest, max((action.within for action in actions), default=0.0))
        over = now >= (max(until, max([late, *since]) + 2 * STAYS) if whole else until)
        if over or (whole and all(watched.lasts(now, late) for watched in self._watched)):
            return True
        if back or (now - self._repeated >= REPEAT and (not whole or now < late)):
            self._repeated = now
            for command in self.commands:
                self._send_again(command, now)
        return False

    def _send_again(self, command: SafeAction, now: float) -> None:
        before = self._again.get(command)
        if before is None or (before.call.done.is_set() and before not in self._repeats):
            if now - self.missing.get(command.target, now) >= AWAY:
                self.away.add(command.target)
                self.missing[command.target] = now
            self._again[command] = sent = self._command(command, now)
            self._repeats.append(sent)

    def _gather(self, now: float) -> None:
        """Note the results of the commands in progress."""
        self._sent = [again for sent in self._sent if (again := self._follow_up(sent, now)) is not None]
        self._repeats = [sent for sent in self._repeats if self._follow_up(sent, now, again=True) is not None]

    def _follow_up(self, sent: _Sent, now: float, *, again: bool = False) -> _Sent | None:
        """The command while in progress, None once it is over; a failed one is sent over the second connection.

        A repeat (`again`) asks the device only if its target is not known to hold the command.
        """
        way, target = sent.rescue or sent.call, sent.action.target
        name = f"{sent.action.do} {target}"
        taken = sent.acknowledged()
        wrong: str | None = str(way.error or "no answer")
        if taken:
            wrong = "" if again and target not in self.unsettled else self._not_held(sent, now)
        if wrong is None:
            return sent
        over = taken or way.done.is_set() or now - sent.since >= (ANSWERS if again else PATIENCE)
        if wrong and not again:
            second = self._rescue(sent.action) if sent.rescue is None and (over or sent.call.behind) else None
            if second is not None:
                return _Sent(sent.action, second if taken else sent.call, now, second)
        if not over:
            return sent
        if again and target in self.unsettled and not wrong:
            self.outcome.append(f"{name}: sent again")
            self._settled = now
            for watched in self._watched:
                watched.bad = None  # the effect of the command begins now
        elif not again and not wrong:
            ramp_that_is_none = sent.action.do == "ramp" and (way is sent.rescue or way.result == 0)
            how = (" at once" if ramp_that_is_none else "") + (" over the second way" if way is sent.rescue else "")
            self.outcome.append(f"{name}: sent{how}")
        elif not again:
            self._again[self._at_once(sent.action) if sent.action.do == "ramp" else sent.action] = sent
            self.fault(f"{name}: failed ({wrong})")
        busy = isinstance(way.error, Busy) and target in self.unsettled  # the second time: it stays busy
        refuses = bool(wrong and (sent.said() or busy or isinstance(way.error, NotSent)))
        (self.refusing.add if refuses else self.refusing.discard)(target)
        if wrong and (busy or not refuses):
            self.missing.setdefault(target, now)
        else:
            self.missing.pop(target, None)
        return None

    def _not_held(self, sent: _Sent, now: float) -> str | None:
        """Why the device does not hold what it acknowledged; empty if it does or cannot say; None while unknown."""
        if self._todo and self._todo[0].do in AT_ONCE:
            return None  # first send everything that is to be commanded now
        if sent.action.do == "ramp":
            return ""  # asked while the ramp is in progress
        if sent.look is None or (sent.look.done.is_set() and sent.look.error is not None):
            sent.look = self._look(sent.action)  # again where it failed: the second way may have made a new connection
        if (said := "" if sent.look is None else sent.said()) is not None:
            return said
        if now - sent.since < ANSWERS:
            return None
        return "" if sent.rescue is not None else "acknowledged, and no answer whether it is held"


def _shown(action: SafeAction, value: float | None = None) -> str:
    """The measured value, or else the bound, in display units; in SI if the channel's quantity is not known."""
    quantity = QUANTITIES.get(CHANNEL_QUANTITY.get(action.target, ""))
    shown = action.value if value is None else value
    return f"{shown:.4g}" if quantity is None else quantity.show(shown, 4)
