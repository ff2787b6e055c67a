"""The order of a lane's instructions: as many at once as registers hold."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from typing import Final, NamedTuple

from undeadzone.compile.ops import LANES, Op, needed

# Cycles until a result is there; 4 where nothing stands.
_LATENCY: Final = {"fdiv": 13, "sqrt": 20, "fneg": 0, "and": 1, "or": 1, "xor": 1, "select": 2}
_USUAL: Final = 4


def ordered(results: list[Op], registers: int) -> list[Op]:
    """The lanes' instructions, scheduled if registers are counted."""
    return by_height(results, registers) if registers else of_graph(results)


def of_graph(results: list[Op]) -> list[Op]:
    """The lanes' instructions in the order in which they were made."""
    return [op for op in needed(results) if op.level == LANES and op.kind != "input"]


def by_height(results: list[Op], registers: int) -> list[Op]:
    """List scheduling of the lanes' instructions.

    First comes what is farthest from the end, until that many numbers are waiting for their use;
    then what makes a register free.
    """
    ops = of_graph(results)
    state = _started(ops, results)
    order: list[Op] = []
    while state.ready:
        best = state.best(len(order), registers)
        order.append(best)
        state.place(best, len(order))
    return order


class _State(NamedTuple):
    """A schedule on the way.

    Attributes:
        users: of each instruction.
        height: cycles from each one's begin to the end.
        waiting: how many operands of each are not there yet.
        at: the cycle from which each can begin.
        left: how many users of each are not placed.
        live: the numbers that wait for a use.
        ready: what can be placed.
    """

    users: dict[int, list[Op]]
    height: dict[int, int]
    waiting: dict[int, int]
    at: dict[int, int]
    left: Counter[int]
    live: set[int]
    ready: list[Op]

    def best(self, clock: int, registers: int) -> Op:
        """What to place in a cycle."""
        if len(self.live) >= registers:
            return max(self.ready, key=lambda op: (self._frees(op), *self._urgency(op)))
        now = [op for op in self.ready if self.at[op.number] <= clock] or self.ready
        return max(now, key=lambda op: (self.height[op.number], self._frees(op), -op.number))

    def place(self, op: Op, clock: int) -> None:
        """Take an instruction for placed; `clock` cycles have passed."""
        self.ready.remove(op)
        for number in {arg.number for arg in op.args}:
            self.left[number] -= 1
            if self.left[number] == 0:
                self.live.discard(number)
        if op.type != "i1" and self.left[op.number]:
            self.live.add(op.number)
        for user in self.users[op.number]:
            self.waiting[user.number] -= 1
            begin = clock + _latency(op) - 1
            self.at[user.number] = max(self.at.get(user.number, 0), begin)
            if self.waiting[user.number] == 0:
                self.ready.append(user)

    def _urgency(self, op: Op) -> tuple[int, int]:
        """How far from the end it is, earlier ones first."""
        return self.height[op.number], -op.number

    def _frees(self, op: Op) -> int:
        """How many registers more are free after an instruction."""
        ended = 0
        for arg in {arg.number: arg for arg in op.args}.values():
            last = arg.level == LANES and self.left[arg.number] == 1
            ended += last and arg.type != "i1"
        return ended - (op.type != "i1")


def _started(ops: list[Op], results: list[Op]) -> _State:
    """A schedule in which nothing is placed."""
    inside = {op.number for op in ops}
    users: dict[int, list[Op]] = defaultdict(list)
    waiting = {}
    left: Counter[int] = Counter({op.number: 1 for op in results})
    for op in ops:
        numbers = {arg.number for arg in op.args}
        left.update(numbers)
        waiting[op.number] = len(numbers & inside)
        for number in numbers:
            users[number].append(op)
    height: dict[int, int] = {}
    for op in reversed(ops):
        beyond = [height[user.number] for user in users[op.number]]
        height[op.number] = _latency(op) + max(beyond, default=0)
    ready = [op for op in ops if waiting[op.number] == 0]
    at = {op.number: 0 for op in ready}
    return _State(users, height, waiting, at, left, set(), ready)


def _latency(op: Op) -> int:
    """Cycles until the result of an instruction is there."""
    return _LATENCY.get(op.kind, _USUAL)


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
