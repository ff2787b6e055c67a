"""Outlining of repeated parts of a graph: copies of the same instructions become a function.

A part grows from instructions that are equal except for inputs and constants: down to operands,
then up to users. Differences between its copies become arguments.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from undeadzone.compile.graph import LANES, Node, Nodes, Results, required_nodes

LEAST: Final = 25  # least number of instructions of a part, and of those that it saves
SEEDS: Final = 5  # rows from which the search for a part starts
COPIES: Final = 24  # largest number of copies of a part
USERS: Final = 64  # largest number of users of a value that are followed
ENOUGH: Final = 0.4  # share of saved instructions at which the search for a part ends
WEIGHT: Final = 2  # cost of an argument or a result [instructions]
_COMMUTES: Final = ("add", "mul", "and", "or")
_LARGE: Final = 1e30  # constants from here on are not arguments

Row = tuple[Node, ...]  # corresponding instructions, one of each copy


class Part(NamedTuple):
    """Function of a repeated part.

    Attributes:
        name: name of the function, the text of its calls.
        inputs: its arguments, inputs named a0, a1 and so on.
        results: nodes that it computes.
    """

    name: str
    inputs: list[Node]
    results: list[Node]


def find_calls(results: Results) -> dict[Node, dict[int, Node]]:
    """Return the calls that results need: of each, the nodes of its results by their numbers."""
    parts: dict[Node, dict[int, Node]] = {}
    for node in required_nodes(itertools.chain(*results)):
        if node.op == "apply":
            parts[node] = {}
        elif node.op == "part":
            parts[node.args[0]][int(node.text)] = node
    return parts


class _Graph:
    """Instructions of a graph, with users and classes.

    Args:
        results: nodes of the results.

    Attributes:
        results: the results.
        order: all instructions, operands first.
        classes: number of each node's class. Nodes of a class are equal trees of instructions,
            except for inputs and constants.
        sizes: number of instructions of a tree, by class.
        users: nodes that have a node as an operand, by node.
    """

    def __init__(self, results: Results) -> None:
        self.results = set(itertools.chain(*results))
        self.order = required_nodes(self.results)
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
        """Yield the rows from which a part may grow, those of the largest trees first."""
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
        graph: the graph.
        seed: row from which the region grows.

    Attributes:
        at: copy and row of each node.
        rows: rows of operands of each row.
        tried: classes from which the same region would grow.
        arguments, results: rows of the arguments and of the results of a call.
    """

    def __init__(self, graph: _Graph, seed: Row) -> None:
        self.graph, self.count = graph, len(seed)
        self.at: dict[Node, tuple[int, Row]] = {}
        self._add_users(self._add_operands([seed]))
        rows = dict.fromkeys(row for _, row in self.at.values())
        self.tried = {graph.classes[row[0]] for row in rows}
        self.rows = {row: self._operands(row) for row in rows}
        while self._drop(self._misplaced()):
            pass
        arguments: dict[Row, None] = {}
        for below in self.rows.values():
            arguments.update(dict.fromkeys(row for row in below if not self._is_known(row)))
        self.arguments = list(arguments)
        self.results = [row for row in self.rows if any(map(self._is_used_outside, row))]

    @property
    def gain(self) -> int:
        """Return the number of instructions that a function saves."""
        passed = self.count * WEIGHT * (len(self.arguments) + len(self.results))
        return (self.count - 1) * len(self.rows) - passed

    def _is_known(self, row: Row) -> bool:
        """Return whether a row is in the body of the function, or is a constant common to all."""
        return row in self.rows or (row[0].op == "const" and len(set(row)) == 1)

    def _is_used_outside(self, node: Node) -> bool:
        """Return whether a node is used outside its own copy."""
        copy = self.at[node][0]
        elsewhere = any(
            user not in self.at or self.at[user][0] != copy for user in self.graph.users[node]
        )
        return elsewhere or node in self.graph.results

    def _add_operands(self, waiting: list[Row]) -> list[Row]:
        """Add rows, and all rows of their operands, if they fit. Return the added rows."""
        added = []
        while waiting:
            row = waiting.pop()
            if self._fits(row):
                self.at.update({node: (k, row) for k, node in enumerate(row)})
                added.append(row)
                waiting += self._operands(row)
        return added

    def _fits(self, row: Row) -> bool:
        """Return whether the nodes of a row are equal instructions, distinct, and not yet added."""
        first = row[0]
        if first.op in ("input", "const", "part", "apply") or len(set(row)) < self.count:
            return False
        alike = (first.op, first.text, first.kind)
        return all((each.op, each.text, each.kind) == alike and each not in self.at for each in row)

    def _operands(self, row: Row) -> list[Row]:
        """Return the rows of operands of a row.

        The operands of commutative instructions are ordered so that copies correspond.
        """
        first, *copies = map(self._sorted_operands, row)
        operands = [first]
        for args in copies:
            if row[0].op in _COMMUTES and self._match_score(first, args[::-1]) > self._match_score(
                first, args
            ):
                args = args[::-1]
            operands.append(args)
        return list(zip(*operands, strict=True))

    def _sorted_operands(self, node: Node) -> Row:
        """Return operands in an order that does not depend on the order of construction."""
        classes = [self.graph.classes[arg] for arg in node.args]
        is_turned = node.op in _COMMUTES and classes[0] > classes[1]
        return node.args[::-1] if is_turned else node.args

    def _match_score(self, first: Row, copy: Row) -> int:
        """Return the score of the correspondence of operands of two copies."""
        if [self.graph.classes[x] for x in first] != [self.graph.classes[x] for x in copy]:
            return -100
        return sum(map(self._node_score, first, copy))

    def _node_score(self, x: Node, y: Node) -> int:
        """Return 2 for nodes that correspond, 0 for unknown ones, -1 if they do not."""
        a, b = self.at.get(x), self.at.get(y)
        if x is y or (a is not None and b is not None and a[1] == b[1]):
            return 2
        return 0 if a is None and b is None else -1

    def _add_users(self, rows: list[Row]) -> None:
        """Add rows of users that correspond in all copies, again and again."""
        while rows:
            row = rows.pop()
            if max(len(self.graph.users[node]) for node in row) > USERS:
                continue
            for user in self.graph.users[row[0]]:
                found = self._corresponding(user, row)
                if len(found) == self.count:
                    rows += self._add_operands([found])

    def _corresponding(self, user: Node, row: Row) -> Row:
        """Return the row of a user of the first node; shorter if a copy has no clear user."""
        users = [user]
        for k, node in enumerate(row[1:], start=1):
            scores = {
                candidate: self._user_score(user, candidate, k)
                for candidate in self.graph.users[node]
            }
            best = max(scores.values(), default=-1)
            best_users = [candidate for candidate, score in scores.items() if score == best]
            if best < 0 or len(best_users) > 1:
                break
            users += best_users
        return tuple(users)

    def _user_score(self, user: Node, candidate: Node, k: int) -> int:
        """Return the score of a node against a node of the first copy (-1: no correspondence)."""
        classes = self.graph.classes
        if candidate in self.at or user in self.at or classes[user] != classes[candidate]:
            return -1
        orders = (
            [candidate.args, candidate.args[::-1]] if user.op in _COMMUTES else [candidate.args]
        )
        return max(
            sum(self._operand_score(*pair, k) for pair in zip(user.args, y, strict=True))
            for y in orders
        )

    def _operand_score(self, x: Node, y: Node, k: int) -> int:
        """Return the score of an operand y of copy k against an operand x of the first copy."""
        place = self.at.get(x)
        if place is not None and place[0] == 0:
            return 2 if place[1][k] is y else -9
        return 1 if x is y else -9 * (y in self.at)

    def _misplaced(self) -> set[Row]:
        """Return the rows with an operand that is not known before the call of its copy.

        Such an operand depends on the same copy by a way through other instructions. A call may
        depend on other copies. `after` has a bit for each copy on which a node depends.
        """
        after: dict[Node, int] = {}
        misplaced = set()
        for row, below in self.rows.items():
            for args in below:
                if args not in self.rows and any(
                    self.at.get(node, (-1,))[0] == k for k, node in enumerate(args)
                ):
                    misplaced.add(row)
        for node in self.graph.order:
            copy, row = self.at.get(node, (-1, ()))
            bits = 0
            for arg in node.args:
                bits |= after[arg]
                arg_copy, arg_row = self.at.get(arg, (-1, ()))
                is_outside = arg_copy != copy or arg_row in misplaced
                if row and is_outside and after[arg] >> copy:
                    misplaced.add(row)
            after[node] = bits | (1 << copy if row else 0)
        return misplaced

    def _drop(self, rows: set[Row]) -> bool:
        """Remove rows from the region. Return whether there were any."""
        for row in rows:
            del self.rows[row]
            for node in row:
                del self.at[node]
        return bool(rows)

    def build_part(self, name: str) -> Part:
        """Build the function of the part from the first copy."""
        nodes = Nodes()
        new: dict[Row, Node] = {}
        for k, row in enumerate(self.arguments):
            new[row] = nodes.intern_input(f"a{k}", LANES, row[0].kind)
        inputs = list(new.values())
        for row in sorted(self.rows, key=lambda row: row[0].number):
            for below in self.rows[row]:
                if below not in new:  # an equal constant
                    new[below] = nodes.copy_node(below[0], ())
            new[row] = nodes.copy_node(row[0], [new[below] for below in self.rows[row]])
        return Part(name, inputs, [new[row] for row in self.results])

    def replace(self, results: Results, name: str) -> Results:
        """Return the results with the copies replaced by calls of the function `name`."""
        nodes, place = Nodes(), {row: str(k) for k, row in enumerate(self.results)}
        new: dict[Node | int, Node] = {}  # by node; of a copy, its call
        waiting: list[Node | int] = [*itertools.chain(*results)]
        while waiting:
            current = waiting[-1]
            copy, row = (
                (current, ()) if isinstance(current, int) else self.at.get(current, (-1, ()))
            )
            needs: Iterable[Node | int]
            if isinstance(current, int):
                needs = [argument[current] for argument in self.arguments]
            else:
                needs = [copy] if row else current.args
            missing = [needed for needed in needs if needed not in new]
            if missing:
                waiting += missing
                continue
            args = [new[needed] for needed in needs]
            if isinstance(current, int):
                new[current] = nodes.intern("apply", *args, text=name, kind="call")
            elif row:
                new[current] = nodes.intern("part", *args, text=place[row], kind=current.kind)
            else:
                new[current] = nodes.copy_node(current, args, LANES)
            waiting.pop()
        return [[new[node] for node in needed] for needed in results]


def _find_region(results: Results) -> _Region | None:
    """Return the repeated part that saves most instructions, or None."""
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
    """Return functions with their repeated parts outlined, each after those that it calls."""
    parts = list[Part]()
    for part in given:
        (inner,) = outline_repeats([part.results], parts)
        parts.append(part._replace(results=inner))
    return parts


def outline_repeats(results: Results, parts: list[Part]) -> Results:
    """Return the results with repeated parts replaced by calls.

    Args:
        results: nodes of the results.
        parts: list to which the functions are added, each after those that it calls.
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
