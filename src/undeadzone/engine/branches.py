"""What only one condition needs, gathered: it is skipped where no lane of a group needs it."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from typing import Final, NamedTuple

from undeadzone.engine.ops import LANES, Op

_NOTHING: Final[frozenset[tuple[int, bool]]] = frozenset()


class Branch(NamedTuple):
    """Instructions that count only where a condition holds, or only where it does not.

    Attributes:
        condition: whose truth is asked of all lanes of a group.
        holds: whether they count where it holds.
        ops: the instructions, in order.
        leaving: those whose values are used after it.
    """

    condition: Op
    holds: bool
    ops: list[Op]
    leaving: list[Op]


def gathered(order: list[Op], results: list[Op], least: int) -> list[Op | Branch]:
    """The same instructions with branches.

    Args:
        order: the instructions, each after what it needs.
        results: what is wanted of them.
        least: instructions that are worth a branch.
    """
    users: dict[int, list[Op]] = defaultdict(list)
    for op in order:
        for number in {arg.number for arg in op.args}:
            users[number].append(op)
    kept = _kept(order, results, users, least)
    if not kept:
        return list(order)
    return _Gathering(order, results, users, kept).all()


def _kept(
    order: list[Op], results: list[Op], users: dict[int, list[Op]], least: int
) -> dict[int, tuple[int, bool]]:
    """The condition, and its value, on which each instruction of a branch counts, by number."""
    wanted = {op.number for op in results}
    guards: dict[int, frozenset[tuple[int, bool]]] = {}
    for op in reversed(order):
        if op.number in wanted:
            guards[op.number] = _NOTHING
            continue
        all_of = [_guards_of_use(op, user, guards[user.number]) for user in users[op.number]]
        guards[op.number] = frozenset.intersection(*all_of) if all_of else _NOTHING
    counts = Counter(itertools.chain.from_iterable(guards.values()))
    worth = {guard for guard, count in counts.items() if count >= least}
    kept = {}
    for number, each in guards.items():
        possible = each & worth
        if possible:
            kept[number] = max(possible, key=lambda guard: (counts[guard], guard))
    return kept


def _guards_of_use(
    op: Op, user: Op, guards: frozenset[tuple[int, bool]]
) -> frozenset[tuple[int, bool]]:
    """On what a use of a value counts, given on what its user does."""
    if user.kind != "select" or user.args[0] is op or user.args[0].level < LANES:
        return guards
    places = [arg is op for arg in user.args[1:]]
    if all(places):
        return guards
    return guards | {(user.args[0].number, places[0])}


class _Gathering:
    """Instructions on the way into their order, those of no branch first.

    Args:
        order, results, users, kept: as above.
    """

    def __init__(
        self,
        order: list[Op],
        results: list[Op],
        users: dict[int, list[Op]],
        kept: dict[int, tuple[int, bool]],
    ) -> None:
        self._users, self._kept = users, kept
        self._wanted = {op.number for op in results}
        self._by_number = {op.number: op for op in order}
        self._waiting: dict[int, int] = {}
        self._free: list[Op] = []
        self._held: dict[tuple[int, bool], list[Op]] = defaultdict(list)
        self._placed: set[int] = set()
        for op in order:
            inside = {arg.number for arg in op.args} & self._by_number.keys()
            guard = kept.get(op.number)
            if guard is not None:
                inside.add(guard[0])  # the condition comes before its branch
            self._waiting[op.number] = len(inside)
            if guard is not None and guard[0] not in {arg.number for arg in op.args}:
                users[guard[0]].append(op)
        for op in order:
            if self._waiting[op.number] == 0:
                self._ready(op)

    def all(self) -> list[Op | Branch]:
        """All instructions."""
        found: list[Op | Branch] = []
        while self._free or any(self._held.values()):
            while self._free:
                op = self._free.pop(0)
                found.append(op)
                self._place(op)
            if any(self._held.values()):
                found.append(self._branch())
        return found

    def _ready(self, op: Op) -> None:
        """Let an instruction be placed."""
        guard = self._kept.get(op.number)
        (self._free if guard is None else self._held[guard]).append(op)

    def _place(self, op: Op) -> None:
        """Take an instruction for placed."""
        self._placed.add(op.number)
        for user in self._users[op.number]:
            self._waiting[user.number] -= 1
            if self._waiting[user.number] == 0:
                self._ready(user)

    def _branch(self) -> Branch:
        """The branch of which most is ready, with all of it that becomes ready on the way."""
        guard = max(self._held, key=lambda guard: (len(self._held[guard]), guard))
        ops = []
        while self._held[guard]:
            op = self._held[guard].pop(0)
            ops.append(op)
            self._place(op)
        inside = {op.number for op in ops}
        leaving = [op for op in ops if self._is_used_outside(op, inside)]
        return Branch(self._by_number[guard[0]], guard[1], ops, leaving)

    def _is_used_outside(self, op: Op, inside: set[int]) -> bool:
        """Whether a value is used after its branch."""
        if op.number in self._wanted:
            return True
        args = [user for user in self._users[op.number] if op in user.args]
        return any(user.number not in inside for user in args)
