"""The safe state: the declared actions in their order, advanced step by step, never cancelled."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from math import inf, nan

from pmabench.base.errors import NotSent
from pmabench.base.quantities import CHANNEL_QUANTITY, QUANTITIES
from pmabench.bench.interface import SafeAction
from pmabench.guard.owner import PATIENCE, Call

AT_ONCE = ("set", "stop", "open", "close")
LOOKS = ("confirm", "rest")
"""Actions that only look: that a value is low, or (which the guard adds) that a motion has ended."""
NO_EFFECT = 0.7
"""A measured value that is high, and has not fallen by a fiftieth of its most in so long [s], shows no effect."""
ANSWERS = 5 * PATIENCE
"""How long an answer whether a command is held is waited for [s].

Without one the command counts as not carried out; over the second way, whose line may hang, it counts as sent.
"""
REPEAT = 0.5
"""While a confirmation is waited for, the commands are sent again so often [s]; they are absolute."""
RETRY = 0.1
"""A command that no device has acknowledged is sent again so often [s], whatever else is waited for."""
AWAY = 0.8
"""A device that acknowledges none for so long [s] is opened anew: some links never come back by themselves."""
STAYS = 0.5
"""All values must stay low together for so long [s] after the last command: a valve may be about to open for that."""
LINGERS = 3.0
"""A command that was not answered may be carried out so much later [s]; those of the safe state are sent until then."""
TWICE = 2
"""One lost answer is no lost device, and one false reading no empty muscle."""
UNANSWERED = f"a command was not answered; after {LINGERS:g} s nobody looks whether it comes"
LEFT = "what it holds is not known, and may be what it held before"
EMPTIER = 20e3
"""A ramp that is so far [Pa] above the measured pressure, and at twice of it, would fill the muscle.

A pressure so far above what is commanded does not follow, where a tenth of what it was is not more.
"""


@dataclass(frozen=True)
class Vent:
    """What came of the safe state: `confirmed`, `commanded` (not confirmed) or `failed`, and each action's outcome."""

    result: str
    actions: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """Whether a measured value says that the bench is safe."""
        return self.result == "confirmed"


@dataclass
class _Sent:
    action: SafeAction
    call: Call
    since: float
    rescue: Call | None = None
    look: Call | None = None
    """Whether the device holds what it acknowledged: an empty text, or a sentence."""

    def said(self) -> str | None:
        """What the device answered whether it holds it; None: nothing, or not yet."""
        look = self.look
        return (look.result or "") if look is not None and look.done.is_set() and look.error is None else None

    def acknowledged(self) -> bool:
        """Whether the device took it, by either way."""
        return any(call is not None and call.done.is_set() and call.error is None for call in (self.call, self.rescue))


@dataclass
class _Watched:
    """How a value was of late that must be low (`confirm`) or stay where it is (`rest`)."""

    action: SafeAction
    floor: float
    value: float | None = None
    seen: float = -inf
    """When the newest value came [s]."""
    since: float | None = None
    """Since when every value has been good [s]."""
    bad: float | None = None
    """Since when none has been [s], and the highest of those."""
    most: float = -inf
    falls: bool = False
    place: float = nan

    def look(self, value: float, now: float) -> bool:
        """Note a new value; whether it has just come back, after good ones."""
        before, bound = self.since, self.action.value
        rest = self.action.do == "rest"
        good = abs(value - self.place) <= bound if rest else self.floor < value < bound
        self.value, self.seen = value, now
        if good:
            self.since, self.bad, self.most = now if before is None else before, None, -inf
        elif value != value:
            self.since = None  # a gauge that fails is no high value
        else:
            self.since, self.bad = None, now if self.bad is None else self.bad
            self.most, self.place = max(self.most, value), value
            self.falls = not rest and value < 0.98 * self.most
        return before is not None and not good

    def lasts(self, now: float, late: float) -> bool:
        """Whether it has been good for long enough, and values still come."""
        return self.since is not None and self.seen - max(self.since, late) >= STAYS and now - self.seen <= STAYS

    def unmoved(self, now: float) -> bool:
        """Whether the commands show no effect on it."""
        return self.bad is not None and now - self.bad >= NO_EFFECT and not self.falls

    def outcome(self, good: bool, now: float) -> str:
        """What is said of it at the end."""
        action, value = self.action, self.value
        name, within = f"{action.do} {action.target}", f"within {action.within:g} s"
        ago = f" {now - self.seen:.2g} s ago" * (now - self.seen > STAYS)
        measured = "nothing measured" if value is None else _shown(action, value) + ago
        if action.do == "rest":
            return f"{name}: {measured}, {'at rest' if good else f'and not at rest {within}'}"
        if good:
            return f"{name}: {measured}, below {_shown(action)}"
        if value is not None and value < action.value:
            measured += ", and not for long" if self.since is not None else ", which a broken wire reads"
        return f"{name}: {measured}, not below {_shown(action)} {within}"


@dataclass
class _Way:
    """How far a pressure is from its safe value, or a motion from its place, while a ramp or a hold goes on."""

    since: float
    """Since when it has come no nearer [s]."""
    farthest: float = -inf
    nearest: float = inf
    away: int = 0

    def fails(self, far: float, expected: float, slack: float, now: float) -> bool:
        """Whether it stays, or goes away, although it is expected to be nearer."""
        self.farthest = max(self.farthest, expected) if self.nearest < inf else max(far, expected)
        if far <= expected + slack or far < 0.98 * self.nearest:
            self.nearest, self.since = far, now
        self.away = self.away + 1 if far > self.farthest + 2 * slack else 0
        return self.away > TWICE or now - self.since >= NO_EFFECT


class SafeState:
    """One pass through the actions.

    `begin` starts an action (the result of a ramp is how long it takes [s], 0 where it is at its end at once) and
    `rescue` tries it over a second way; `look` asks whether a command is held (None: it cannot be asked); all return
    at once. Commands that follow each other go out together; `ramp`, `hold` and `confirm` are waited for until they
    are done or their time is over, and in the end all that is looked at must be good at the same time. A value at or
    below its entry in `floors` [SI] confirms nothing, nor does any within `LINGERS` after `unanswered` [s]. `motions`
    are outputs that move: in a hurry they stop where they are, while a pressure is let go. `expected` says where an
    output is commanded to be now, and how far a measured value may be from there [SI]; `compare` asks devices that
    confirm whether they measure as they did when the bench was armed.
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
    ) -> None:
        self._compare = compare
        self._asked: list[Call] | None = None
        """What devices that confirm say of the way they measure."""
        self._floors, self._motions, self._unanswered, self._expected = floors, motions, unanswered, expected
        self._ends: dict[str, float] = {}
        """Where motions are sent by a ramp [SI]; they were not stopped yet."""
        self._ways: dict[str, _Way] = {}
        self._todo = list(actions)
        self._finals = [action for action in actions if action.do in LOOKS]
        while self._todo and self._todo[-1].do in LOOKS:
            self._todo.pop()
        self._begin, self._rescue, self._look = begin, rescue, look
        self._sent: list[_Sent] = []
        self._begun = self._since = self._repeated = now
        self._ramp: _Sent | None = None
        self._doubts = self._emptier = 0
        """How often in a row the device of a ramp did not say where it is, and its muscle was measured emptier."""
        self._watched: list[_Watched] = []
        self.outcome: list[str] = []
        self.faults: list[str] = []
        """What went wrong, although all may be low in the end; the bench is looked at before anything runs on it."""
        self.missing: dict[str, float] = {}
        """Targets that have not acknowledged their command, and since when [s]."""
        self.away: set[str] = set()
        """Those of them whose device is to be opened anew."""
        self.refusing: set[str] = set()
        """Targets whose device answers, and does not obey: it refused the command, or holds something else."""
        self.unmoved: set[str] = set()
        """Channels that have not fallen, or not come to rest, after all commands."""
        self.commands: list[SafeAction] = []
        """What is commanded again, a ramp by its end."""
        self._again: dict[SafeAction, _Sent] = {}
        """How it was sent last."""
        self._repeats: list[_Sent] = []
        """Those under way."""
        self._settled = -inf
        """When a target that was missing or refusing has held its command first [s]."""
        self.vent: Vent | None = None
        """What came of it, when it is over."""

    def _at_once(self, action: SafeAction) -> SafeAction:
        """The command in place of a ramp that may not go on: no motion is sped up."""
        return replace(action, do="stop" if action.target in self._motions else "set")

    def hurry(self) -> None:
        """Skip the waits: send every command that is left now, and wait for confirmations only."""
        left = (action for action in self._todo if action.do not in {"hold", *LOOKS})
        self._todo = [self._at_once(action) if action.do == "ramp" else action for action in left]

    def step(self, now: float, latest: Mapping[str, float]) -> bool:
        """Do what can be done now, with the `latest` measured values [SI]; whether it is over."""
        self._gather(now)
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
            result = "failed" if self.faults and not low else "commanded"
            self.vent = Vent("confirmed" if low and not self.unsettled else result, tuple(self.outcome))
        return self.vent is not None

    @property
    def waits(self) -> bool:
        """Whether a ramp or a hold is waited for."""
        return bool(self._todo) and self._todo[0].do in {"ramp", "hold"}

    def _late(self) -> float:
        """Since when nothing can come any more that was sent before [s]."""
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
        """Note what went wrong."""
        self.outcome.append(text)
        self.faults.append(text)

    def _go_on(self, now: float) -> None:
        """To the next action."""
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
        """Whether the next action may begin."""
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
        if action.do in AT_ONCE:
            self.commands.append(action)
        return sent

    def _command(self, action: SafeAction, now: float) -> _Sent:
        if action.do == "stop":
            self._ends.pop(action.target, None)
        return _Sent(action, self._begin(action), now)

    def _astray(self, sent: _Sent, now: float, latest: Mapping[str, float], expected: float) -> bool:
        """Whether a ramp may not go on: its device is away or began anew, and would be filled when it is back."""
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
        """Whether all values are good together, or their time is over; meanwhile the commands are sent again."""
        if not self._watched:
            self._watched = [_Watched(action, self._floors.get(action.target, -inf)) for action in actions]
        late, back = self._late(), False
        for watched in self._watched:
            value = latest.get(watched.action.target)
            back = (value is not None and watched.look(value, now)) or back
            watched.since = None if self._sent else watched.since
            if watched.unmoved(now) and watched.action.target in self._ends:
                self._end_way(watched.action.target, now)
                watched.bad = None
            elif watched.unmoved(now):
                self.unmoved.add(watched.action.target)
        since = [watched.since for watched in self._watched if watched.since is not None]
        whole = len(since) == len(self._watched) and not self.unsettled
        until = self._since + max((action.within for action in actions), default=0.0)
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
        """Note the results of the commands under way."""
        self._sent = [again for sent in self._sent if (again := self._follow_up(sent, now)) is not None]
        self._repeats = [sent for sent in self._repeats if self._follow_up(sent, now, again=True) is not None]

    def _follow_up(self, sent: _Sent, now: float, *, again: bool = False) -> _Sent | None:
        """The command as it is waited for further, or None where it is over; one that fails first goes the second way.

        One that is sent `again` is asked for only where its target is not known to hold it.
        """
        way, target = sent.rescue or sent.call, sent.action.target
        name = f"{sent.action.do} {target}"
        taken = sent.acknowledged()
        wrong: str | None = str(way.error or "no answer")
        if taken:
            wrong = "" if again and target not in self.unsettled else self._not_held(sent, now)
        if wrong is None:
            return sent
        over = taken or way.done.is_set() or now - sent.since >= PATIENCE
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
                watched.bad = None  # what it does begins now
        elif not again and not wrong:
            ramp_that_is_none = sent.action.do == "ramp" and (way is sent.rescue or way.result == 0)
            how = (" at once" if ramp_that_is_none else "") + (" over the second way" if way is sent.rescue else "")
            self.outcome.append(f"{name}: sent{how}")
        elif not again:
            self._again[self._at_once(sent.action) if sent.action.do == "ramp" else sent.action] = sent
            self.fault(f"{name}: failed ({wrong})")
        refuses = bool(wrong and (sent.said() or isinstance(way.error, NotSent)))
        (self.refusing.add if refuses else self.refusing.discard)(target)
        if wrong and not refuses:
            self.missing.setdefault(target, now)
        else:
            self.missing.pop(target, None)
        return None

    def _not_held(self, sent: _Sent, now: float) -> str | None:
        """Why the device does not hold what it acknowledged; empty where it does or cannot say; None: not known yet."""
        if self._todo and self._todo[0].do in AT_ONCE:
            return None  # first everything that is to be commanded now
        if sent.action.do == "ramp":
            return ""  # asked while it goes on
        if sent.look is None or (sent.look.done.is_set() and sent.look.error is not None):
            sent.look = self._look(sent.action)  # again where it failed: the second way may have made a new connection
        if (said := "" if sent.look is None else sent.said()) is not None:
            return said
        if now - sent.since < ANSWERS:
            return None
        return "" if sent.rescue is not None else "acknowledged, and no answer whether it is held"


def _shown(action: SafeAction, value: float | None = None) -> str:
    """What is measured, or else the bound, in the unit that people read; in SI where the channel's name has none."""
    quantity = QUANTITIES.get(CHANNEL_QUANTITY.get(action.target, ""))
    shown = action.value if value is None else value
    return f"{shown:.4g}" if quantity is None else quantity.show(shown, 4)
