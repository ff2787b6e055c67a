"""Order of a lane's instructions, and branches that skip instructions.

As many go at once as registers hold. Instructions that only one truth needs are gathered, and
skipped if no lane of a group needs them.
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from graphlib import TopologicalSorter
from typing import Final, NamedTuple

from undeadzone.compile.graph import LANES, Node, required_nodes

# Cycles until a result is there, by instruction or function (4 if missing).
_LATENCY: Final = {
    **{"div": 13, "sqrt": 20, "neg": 0, "and": 1, "or": 1, "xor": 1, "not": 1, "select": 2},
}
_USUAL: Final = 4

Users = dict[Node, list[Node]]


def lane_instructions(results: Iterable[Node]) -> list[Node]:
    """Return the lanes' instructions in the order of creation."""
    return [node for node in required_nodes(results) if node.level == LANES and node.op != "input"]


def _find_users(order: list[Node]) -> Users:
    """Return the instructions that use each value."""
    users: Users = defaultdict(list)
    for node in order:
        for arg in set(node.args):
            users[arg].append(node)
    return users


def order_instructions(results: list[Node], registers: int) -> list[Node]:
    """Return the lanes' instructions in order, by list scheduling if registers are counted.

    The instruction farthest from the end comes first, until that many numbers wait for their use.
    Then the one that frees a register.
    """
    instructions = lane_instructions(results)
    if not registers:
        return order_depth_first(instructions, results)
    state = _start_schedule(instructions, results)
    order: list[Node] = []
    while state.ready:
        best = state.choose_next(len(order), registers)
        order.append(best)
        state.place_instruction(best, len(order))
    return order


def order_depth_first(instructions: list[Node], results: list[Node]) -> list[Node]:
    """Return the instructions, each directly after its operands, the longest chain first.

    Args:
        instructions: the instructions, each behind those that it needs.
        results: the last ones.
    """
    length: dict[Node, int] = {}
    for node in instructions:
        longest = 0
        for arg in node.args:
            longest = max(longest, length.get(arg, 0))
        length[node] = 1 + longest
    order: dict[Node, None] = {}
    for result in results:
        waiting = [(result, _longest_first(result, length))] if result in length else []
        while waiting:
            node, operands = waiting[-1]
            needed_first = next((arg for arg in operands if arg not in order), None)
            if needed_first is not None:
                waiting.append((needed_first, _longest_first(needed_first, length)))
            else:
                order[node] = None
                waiting.pop()
    return list(order)


def _longest_first(node: Node, length: dict[Node, int]) -> Iterator[Node]:
    """Return the operands of a node that are instructions, those of the longest chain first."""
    arguments = [arg for arg in node.args if arg in length]
    return iter(sorted(arguments, key=length.__getitem__, reverse=True))


class _ListSchedule(NamedTuple):
    """State of a list schedule.

    Attributes:
        users: of each instruction.
        height: cycles from each one's begin to the end.
        waiting: how many operands of each are not there yet.
        at: the cycle from which each can begin.
        left: how many users of each are not placed.
        live: the numbers that wait for a use.
        ready: instructions that can be placed.
    """

    users: Users
    height: dict[Node, int]
    waiting: dict[Node, int]
    at: dict[Node, int]
    left: Counter[Node]
    live: set[Node]
    ready: list[Node]

    def choose_next(self, clock: int, registers: int) -> Node:
        """Return the instruction to place in a cycle."""
        frees = self._count_freed
        height = self.height
        if len(self.live) >= registers:
            return max(self.ready, key=lambda node: (frees(node), height[node], -node.number))
        now = [node for node in self.ready if self.at[node] <= clock] or self.ready
        return max(now, key=lambda node: (height[node], frees(node), -node.number))

    def place_instruction(self, node: Node, clock: int) -> None:
        """Mark an instruction as placed, after `clock` cycles."""
        self.ready.remove(node)
        for arg in set(node.args):
            self.left[arg] -= 1
            if self.left[arg] == 0:
                self.live.discard(arg)
        if node.kind != "bool" and self.left[node]:
            self.live.add(node)
        for user in self.users[node]:
            self.waiting[user] -= 1
            self.at[user] = max(self.at.get(user, 0), clock + _latency_cycles(node) - 1)
            if self.waiting[user] == 0:
                self.ready.append(user)

    def _count_freed(self, node: Node) -> int:
        """Return by how many registers more are free after an instruction."""
        ended = 0
        for arg in set(node.args):
            last = arg.level == LANES and self.left[arg] == 1
            ended += last and arg.kind != "bool"
        return ended - (node.kind != "bool")


def _start_schedule(order: list[Node], results: list[Node]) -> _ListSchedule:
    """Return a schedule in which nothing is placed."""
    inside = set(order)
    users = _find_users(order)
    waiting = {node: len(inside.intersection(node.args)) for node in order}
    left = Counter(set(results))
    height: dict[Node, int] = {}
    for node in order:
        left.update(set(node.args))
    for node in reversed(order):
        height[node] = _latency_cycles(node) + max(
            (height[user] for user in users[node]), default=0
        )
    ready = [node for node in order if waiting[node] == 0]
    return _ListSchedule(users, height, waiting, dict.fromkeys(ready, 0), left, set(), ready)


def _latency_cycles(node: Node) -> int:
    """Return the cycles until the result of an instruction is available."""
    is_xor = node.op == "ne" and node.args[0].kind == "bool"
    return 1 if is_xor else _LATENCY.get(node.text or node.op, _USUAL)


class Branch(NamedTuple):
    """Instructions that count only if a truth holds, or only if it does not hold.

    Attributes:
        truth: condition, tested in all lanes of a group.
        holds: whether they count if it holds.
        nodes: the instructions, in order.
        leaving: those whose values are used after it.
    """

    truth: Node
    holds: bool
    nodes: list[Node]
    leaving: list[Node]


Guard = tuple[Node, bool]  # a truth, and its value on which an instruction counts


def gather_branches(order: list[Node], results: list[Node], least: int) -> list[Node | Branch]:
    """Return the same instructions with branches.

    Args:
        order: the instructions, each after its operands.
        results: nodes that they compute.
        least: instructions that are worth a branch.
    """
    users = _find_users(order)
    guard_of = _assign_guards(order, set(results), users, least)
    return _Gathering(order, set(results), users, guard_of).order_all() if guard_of else list(order)


def _assign_guards(
    order: list[Node], results: set[Node], users: Users, least: int
) -> dict[Node, Guard]:
    """Return the guard of each instruction that belongs to a branch."""
    nothing: frozenset[Guard] = frozenset()
    guards: dict[Node, frozenset[Guard]] = {}
    for node in reversed(order):
        all_of = [_guards_of_use(node, user, guards[user]) for user in users[node]]
        needless = node in results or not all_of
        guards[node] = nothing if needless else frozenset.intersection(*all_of)
    counts = Counter(itertools.chain.from_iterable(guards.values()))
    worth = {guard for guard, count in counts.items() if count >= least}
    guard_of = {}
    for node, each in guards.items():
        possible = each & worth
        if possible:
            guard_of[node] = max(possible, key=lambda guard: (counts[guard], _guard_rank(guard)))
    return guard_of


def _guard_rank(guard: Guard) -> tuple[int, bool]:
    """Return the sort key that decides between equal guards."""
    return guard[0].number, guard[1]


def _guards_of_use(node: Node, user: Node, guards: frozenset[Guard]) -> frozenset[Guard]:
    """Return the guards of a use of a value, given the guards of its user."""
    if user.op != "select" or user.args[0] is node or user.args[0].level < LANES:
        return guards
    _, yes, no = user.args
    return guards if yes is no else guards | {(user.args[0], yes is node)}


class _Gathering:
    """State of the ordering of instructions, those outside branches first.

    Args:
        order, results, users, guard_of: as above.
    """

    def __init__(
        self, order: list[Node], results: set[Node], users: Users, guard_of: dict[Node, Guard]
    ) -> None:
        self._results = results
        self._users = users
        self._guard_of = guard_of
        self._place_of = {node: place for place, node in enumerate(order)}
        self._free: list[tuple[int, Node]] = []
        self._ready: dict[Guard, list[tuple[int, Node]]] = defaultdict(list)
        inside = set(order)
        self._sorter = TopologicalSorter({node: inside.intersection(node.args) for node in order})
        for node in order:
            if node in guard_of:
                self._sorter.add(node, guard_of[node][0])  # the truth comes before its branch
        self._sorter.prepare()
        self._release_dependents()

    def order_all(self) -> list[Node | Branch]:
        """Return all instructions in order."""
        found: list[Node | Branch] = []
        while self._free or any(self._ready.values()):
            while self._free:
                _, node = heapq.heappop(self._free)
                found.append(node)
                self._release_dependents(node)
            if any(self._ready.values()):
                found.append(self._take_branch())
        return found

    def _release_dependents(self, *nodes: Node) -> None:
        """Mark instructions as placed and queue the instructions that become ready."""
        self._sorter.done(*nodes)
        for node in self._sorter.get_ready():
            ready = self._ready[self._guard_of[node]] if node in self._guard_of else self._free
            heapq.heappush(ready, (self._place_of[node], node))

    def _take_branch(self) -> Branch:
        """Return the branch with most ready instructions, with all that become ready on
        the way.
        """
        guard = max(self._ready, key=lambda guard: (len(self._ready[guard]), _guard_rank(guard)))
        nodes = []
        while self._ready[guard]:
            nodes.append(heapq.heappop(self._ready[guard])[1])
            self._release_dependents(nodes[-1])
        inside = set(nodes)
        leaving = [node for node in nodes if self._is_used_outside(node, inside)]
        return Branch(*guard, nodes, leaving)

    def _is_used_outside(self, node: Node, inside: set[Node]) -> bool:
        """Return whether a value is used after its branch."""
        if node in self._results:
            return True
        return any(node in user.args and user not in inside for user in self._users[node])
