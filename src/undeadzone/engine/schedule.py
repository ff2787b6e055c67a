"""The order of a lane's instructions: as many at once as registers hold."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Final, NamedTuple

from undeadzone.engine.ops import LANES, Op, needed

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
