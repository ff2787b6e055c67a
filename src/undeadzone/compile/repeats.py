"""Repeated parts of a graph as functions: the same instructions on the same operands.

A part grows from instructions that are alike for any inputs and constants below them: down to
operands, then up to users. Differences between its copies become arguments.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from undeadzone.compile.graph import LANES, Node, Nodes, Results, required_nodes

LEAST: Final = 25  # instructions that a part must have, and that it must save
SEEDS: Final = 5  # that are tried for a part
COPIES: Final = 24  # of a part, at most
USERS: Final = 64  # of a value, beyond which none is followed
ENOUGH: Final = 0.4  # share of all instructions saved at which no other part is looked for
WEIGHT: Final = 2  # instructions that pass an argument or a result
_COMMUTES: Final = ("add", "mul", "and", "or")
_LARGE: Final = 1e30  # constants from here on stay constants

Row = tuple[Node, ...]  # the same instruction of each copy


class Part(NamedTuple):
    """Function made of a repeated part.

    Attributes:
        name: text of a call.
        inputs: its arguments, inputs named a0, a1 and so on.
        results: nodes that it computes.
    """

    name: str
    inputs: list[Node]
    results: list[Node]


def find_calls(results: Results) -> dict[Node, dict[int, Node]]:
    """Return the calls that results need: of each, the nodes of its results by their numbers."""
    taken: dict[Node, dict[int, Node]] = {}
    for node in required_nodes(itertools.chain(*results)):
        if node.op == "apply":
            taken[node] = {}
        elif node.op == "part":
            taken[node.args[0]][int(node.text)] = node
    return taken


class _Graph:
    """Instructions that results need, with users and classes.

    Args:
        results: the nodes.

    Attributes:
        classes: the number of each node's class: equal trees of instructions, whatever inputs and
            constants they have.
        sizes: instructions of a class.
        users: of each node.
    """

    def __init__(self, results: Results) -> None:
        self.wanted = set(itertools.chain(*results))
        self.order = required_nodes(self.wanted)
        self.classes: dict[Node, int] = {}
        self.sizes: dict[int, int] = {}
        self.users = defaultdict[Node, list[Node]](list)
        known: dict[object, int] = {}
        for node in self.order:
            below = [self.classes[arg] for arg in node.args]
            text = "" if node.op == "input" or _is_free(node) else node.text
            key = (node.op, text, node.kind, *(sorted(below) if node.op in _COMMUTES else below))
            mine = self.classes[node] = known.setdefault(key, len(known))
            self.sizes[mine] = min(10**9, 1 + sum(self.sizes[each] for each in below))
            for arg in dict.fromkeys(node.args):
                self.users[arg].append(node)

    def find_seeds(self) -> Iterator[Row]:
        """Yield the rows from which a part may grow, the largest first."""
        members = defaultdict[int, list[Node]](list)
        for node in self.order:
            if node.args and node.op not in ("apply", "part"):
                members[self.classes[node]].append(node)
        found = [k for k, each in members.items() if 2 <= len(each) <= COPIES]
        for each in sorted(found, key=lambda k: -self.sizes[k]):
            if self.sizes[each] >= LEAST:
                yield tuple(members[each])


def _is_free(node: Node) -> bool:
    """Return whether a constant may differ between copies."""
    return node.op == "const" and node.is_real and abs(float(node.text)) < _LARGE


class _Region:
    """Copies of a part, as rows of corresponding nodes.

    Args:
        graph: the instructions.
        seed: the row that it grows from.

    Attributes:
        at: the copy and the row of each node.
        rows: the operand rows of each row.
        tried: classes from which the same region would grow.
        arguments, results: rows that a call is given, and rows that others use.
    """

    def __init__(self, graph: _Graph, seed: Row) -> None:
        self.graph, self.count = graph, len(seed)
        self.at: dict[Node, tuple[int, Row]] = {}
        self._climb(self._take([seed]))
        taken = dict.fromkeys(row for _, row in self.at.values())
        self.tried = {graph.classes[row[0]] for row in taken}
        self.rows = {row: self._operands(row) for row in taken}
        while self._drop(self._misplaced()):
            pass
        given: dict[Row, None] = {}
        for below in self.rows.values():
            given.update(dict.fromkeys(row for row in below if not self._is_known(row)))
        self.arguments = list(given)
        self.results = [row for row in self.rows if any(map(self._is_used_outside, row))]

    @property
    def gain(self) -> int:
        """Return the instructions that are saved."""
        passed = self.count * WEIGHT * (len(self.arguments) + len(self.results))
        return (self.count - 1) * len(self.rows) - passed

    def _is_known(self, row: Row) -> bool:
        """Return whether the body has a row: its instructions and equal constants."""
        return row in self.rows or (row[0].op == "const" and len(set(row)) == 1)

    def _is_used_outside(self, node: Node) -> bool:
        """Return whether another than its own copy uses a node."""
        copy = self.at[node][0]
        elsewhere = any(
            user not in self.at or self.at[user][0] != copy for user in self.graph.users[node]
        )
        return elsewhere or node in self.graph.wanted

    def _take(self, waiting: list[Row]) -> list[Row]:
        """Add rows and all rows of operands that fit, and return those added."""
        added = []
        while waiting:
            row = waiting.pop()
            if self._fits(row):
                self.at.update({node: (k, row) for k, node in enumerate(row)})
                added.append(row)
                waiting += self._operands(row)
        return added

    def _fits(self, row: Row) -> bool:
        """Return whether nodes are the same instruction, distinct and free."""
        first = row[0]
        if first.op in ("input", "const", "part", "apply") or len(set(row)) < self.count:
            return False
        alike = (first.op, first.text, first.kind)
        return all((each.op, each.text, each.kind) == alike and each not in self.at for each in row)

    def _operands(self, row: Row) -> list[Row]:
        """Return the rows of operands, those of sums and products in orders that correspond."""
        first, *others = map(self._sorted_operands, row)
        given = [first]
        for args in others:
            if row[0].op in _COMMUTES and self._meetings(first, args[::-1]) > self._meetings(
                first, args
            ):
                args = args[::-1]
            given.append(args)
        return list(zip(*given, strict=True))

    def _sorted_operands(self, node: Node) -> Row:
        """Return operands in an order that does not depend on when they were made."""
        classes = [self.graph.classes[arg] for arg in node.args]
        is_turned = node.op in _COMMUTES and classes[0] > classes[1]
        return node.args[::-1] if is_turned else node.args

    def _meetings(self, first: Row, other: Row) -> int:
        """Return how well operands of two copies correspond."""
        if [self.graph.classes[x] for x in first] != [self.graph.classes[x] for x in other]:
            return -100
        return sum(map(self._meeting, first, other))

    def _meeting(self, x: Node, y: Node) -> int:
        """Return 2 for nodes that correspond, 0 for unknown ones, -1 if they do not."""
        a, b = self.at.get(x), self.at.get(y)
        if x is y or (a is not None and b is not None and a[1] == b[1]):
            return 2
        return 0 if a is None and b is None else -1

    def _climb(self, rows: list[Row]) -> None:
        """Add rows of users that are alike and whose known operands correspond."""
        while rows:
            row = rows.pop()
            if max(len(self.graph.users[node]) for node in row) > USERS:
                continue
            for user in self.graph.users[row[0]]:
                found = self._corresponding(user, row)
                if len(found) == self.count:
                    rows += self._take([found])

    def _corresponding(self, user: Node, row: Row) -> Row:
        """Return a user of a row's first node and those of the others, as far as they are clear."""
        found = [user]
        for k, node in enumerate(row[1:], start=1):
            scores = {other: self._score(user, other, k) for other in self.graph.users[node]}
            best = max(scores.values(), default=-1)
            clear = [other for other, score in scores.items() if score == best]
            if best < 0 or len(clear) > 1:
                break
            found += clear
        return tuple(found)

    def _score(self, user: Node, other: Node, k: int) -> int:
        """Return the score of a node against a node of the first copy (-1: no correspondence)."""
        classes = self.graph.classes
        if other in self.at or user in self.at or classes[user] != classes[other]:
            return -1
        orders = [other.args, other.args[::-1]] if user.op in _COMMUTES else [other.args]
        return max(
            sum(self._agreement(*pair, k) for pair in zip(user.args, y, strict=True))
            for y in orders
        )

    def _agreement(self, x: Node, y: Node, k: int) -> int:
        """Return how well an operand corresponds to one of the first copy."""
        known = self.at.get(x)
        if known is not None and known[0] == 0:
            return 2 if known[1][k] is y else -9
        return 1 if x is y else -9 * (y in self.at)

    def _misplaced(self) -> set[Row]:
        """Return the rows whose operands a call cannot be given ahead of it.

        Copies may need those before them. `after` holds a bit for each copy that a node needs.
        """
        after: dict[Node, int] = {}
        wrong = set()
        for row, below in self.rows.items():
            for args in below:
                if args not in self.rows and any(
                    self.at.get(node, (-1,))[0] == k for k, node in enumerate(args)
                ):
                    wrong.add(row)
        for node in self.graph.order:
            copy, row = self.at.get(node, (-1, ()))
            bits = 0
            for arg in node.args:
                bits |= after[arg]
                other, theirs = self.at.get(arg, (-1, ()))
                is_outside = other != copy or theirs in wrong
                if row and is_outside and after[arg] >> copy:
                    wrong.add(row)
            after[node] = bits | (1 << copy if row else 0)
        return wrong

    def _drop(self, rows: set[Row]) -> bool:
        """Leave rows out. Return whether there were any."""
        for row in rows:
            del self.rows[row]
            for node in row:
                del self.at[node]
        return bool(rows)

    def build_part(self, name: str) -> Part:
        """Build the function from the first copy."""
        nodes = Nodes()
        made: dict[Row, Node] = {}
        for k, row in enumerate(self.arguments):
            made[row] = nodes.intern_input(f"a{k}", LANES, row[0].kind)
        inputs = list(made.values())
        for row in sorted(self.rows, key=lambda row: row[0].number):
            for below in self.rows[row]:
                if below not in made:  # an equal constant
                    made[below] = nodes.copy_node(below[0], ())
            made[row] = nodes.copy_node(row[0], [made[below] for below in self.rows[row]])
        return Part(name, inputs, [made[row] for row in self.results])

    def replace(self, results: Results, name: str) -> Results:
        """Return results with calls in the place of the copies."""
        nodes, place = Nodes(), {row: str(k) for k, row in enumerate(self.results)}
        new: dict[Node | int, Node] = {}  # by node; of a copy, its call
        waiting: list[Node | int] = [*itertools.chain(*results)]
        while waiting:
            one = waiting[-1]
            copy, row = (one, ()) if isinstance(one, int) else self.at.get(one, (-1, ()))
            needs: Iterable[Node | int]
            if isinstance(one, int):
                needs = [given[one] for given in self.arguments]
            else:
                needs = [copy] if row else one.args
            missing = [each for each in needs if each not in new]
            if missing:
                waiting += missing
                continue
            args = [new[each] for each in needs]
            if isinstance(one, int):
                new[one] = nodes.intern("apply", *args, text=name, kind="call")
            elif row:
                new[one] = nodes.intern("part", *args, text=place[row], kind=one.kind)
            else:
                new[one] = nodes.copy_node(one, args, LANES)
            waiting.pop()
        return [[new[node] for node in each] for each in results]


def _find_region(results: Results) -> _Region | None:
    """Return the repeated part that saves most, or None."""
    graph = _Graph(results)
    best, covered = None, set[int]()
    seeds = (seed for seed in graph.find_seeds() if graph.classes[seed[0]] not in covered)
    for seed in itertools.islice(seeds, SEEDS):
        region = _Region(graph, seed)
        covered |= region.tried
        if region.gain > (LEAST if best is None else best.gain) and len(region.rows) >= LEAST:
            best = region
            if best.gain > ENOUGH * len(graph.order):
                break
    return best


def outline_parts(given: list[Part]) -> list[Part]:
    """Return functions in which repeated parts are calls, each after those that it calls."""
    parts = list[Part]()
    for part in given:
        (inner,) = outline_repeats([part.results], parts)
        parts.append(part._replace(results=inner))
    return parts


def outline_repeats(results: Results, parts: list[Part]) -> Results:
    """Return results in which repeated parts are calls.

    Args:
        results: the nodes.
        parts: gets the functions, each after those that it calls.
    """
    region = _find_region(results)
    while region is not None:
        whole = region.build_part("")
        (inner,) = outline_repeats([whole.results], parts)
        name = f"part_{len(parts)}"
        parts.append(Part(name, whole.inputs, inner))
        results = region.replace(results, name)
        region = _find_region(results)
    return results
