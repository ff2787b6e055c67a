"""Repeated parts: found up to renaming, called in an order that can be; nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.compile import repeats
from undeadzone.compile.graph import LANES, Node, Nodes, Results, required_nodes
from undeadzone.compile.repeats import Part, outline_repeats

FOLD = {"add": lambda a, b: a + b, "mul": lambda a, b: a * b, "sub": lambda a, b: a - b}


def chain(nodes: Nodes, x: Node, y: Node, factor: float, length: int = 40) -> Node:
    """A part: a long sum of products of two operands, with a number of its own."""
    value = x
    for k in range(length):
        value = nodes.intern("mul", value, nodes.intern("add", y, nodes.intern_constant(factor)))
        value = nodes.intern("sub", value, nodes.intern_constant(float(k)))
    return value


def evaluate(results: Results, parts: list[Part], given: dict[str, float]) -> list[list[float]]:
    """The numbers of results; calls are followed."""
    known: dict[Node, object] = {}
    functions = {part.name: part for part in parts}
    for node in required_nodes([node for each in results for node in each]):
        args = [known[arg] for arg in node.args]
        if node.op == "input":
            known[node] = given[node.text]
        elif node.op == "const":
            known[node] = float(node.text)
        elif node.op == "apply":
            part = functions[node.text]
            inputs = {one.text: float(value) for one, value in zip(part.inputs, args, strict=True)}
            (known[node],) = evaluate([part.results], parts, inputs)
        elif node.op == "part":
            known[node] = args[0][int(node.text)]
        else:
            known[node] = FOLD[node.op](*args)
    return [[float(known[node]) for node in each] for each in results]


def inputs(nodes: Nodes, count: int) -> list[Node]:
    return [nodes.intern_input(f"s{k}", LANES) for k in range(count)]


@pytest.mark.parametrize("copies", [2, 3, 5])
def test_copies_with_other_inputs_and_numbers_become_one_function(copies: int) -> None:
    nodes = Nodes()
    given = inputs(nodes, copies + 1)
    results = [[chain(nodes, x, given[-1], 2.0 + k) for k, x in enumerate(given[:-1])]]
    parts: list[Part] = []
    outlined = outline_repeats(results, parts)
    assert len(parts) == 1
    calls = [node for node in required_nodes(outlined[0]) if node.op == "apply"]
    assert len(calls) == copies
    assert len(required_nodes(outlined[0])) < len(required_nodes(results[0])) / 2
    names = [one.text for one in given]
    numbers = dict(zip(names, np.random.default_rng(0).normal(size=copies + 1), strict=True))
    assert evaluate(outlined, parts, numbers) == evaluate(results, [], numbers)


def test_copies_that_share_their_end_are_called_before_it() -> None:
    nodes = Nodes()
    given = inputs(nodes, 3)
    one, two = (chain(nodes, x, given[2], 2.0) for x in given[:2])
    mixed = nodes.intern("mul", nodes.intern("add", one, two), chain(nodes, given[2], one, 5.0))
    parts: list[Part] = []
    outlined = outline_repeats([[mixed], [two]], parts)
    assert len(parts) == 1
    numbers = {"s0": 0.3, "s1": -0.7, "s2": 0.1}
    assert evaluate(outlined, parts, numbers) == evaluate([[mixed], [two]], [], numbers)


def turned(nodes: Nodes, u: Node, v: Node, seed: int, length: int = 20) -> Node:
    """A part of the same operations, whose operands stand in an order of its own.

    Two factors are alike but for a number.
    """
    random = np.random.default_rng(seed)

    def join(op: str, *pair: Node) -> Node:
        return nodes.intern(op, *pair[:: int(random.choice([1, -1]))])

    for k in range(length):
        numbers = [nodes.intern_constant(0.01 * (2 * k + j)) for j in range(2)]
        u, v = join("add", join("mul", u, v), u), join("mul", join("add", u, v), v)
        u = join("mul", *[nodes.intern("sub", u, number) for number in numbers])
    return join("add", u, v)


@pytest.mark.parametrize("seed", [0, 10, 20, 30])
def test_copies_whose_operands_stand_the_other_way_round_become_one_function(seed: int) -> None:
    nodes = Nodes()
    given = inputs(nodes, 4)
    results = [[turned(nodes, x, given[3], seed + k) for k, x in enumerate(given[:3])]]
    parts: list[Part] = []
    outlined = outline_repeats(results, parts)
    assert len(parts) == 1
    assert len(required_nodes(outlined[0])) < len(required_nodes(results[0])) / 8
    numbers = {"s0": 0.03, "s1": -0.07, "s2": 0.1, "s3": 0.09}
    assert evaluate(outlined, parts, numbers) == evaluate(results, [], numbers)


def test_what_saves_nothing_stays() -> None:
    nodes = Nodes()
    given = inputs(nodes, 3)
    short = [[chain(nodes, x, given[2], 2.0, length=3) for x in given[:2]]]
    parts: list[Part] = []
    assert outline_repeats(short, parts) is short
    assert parts == []


def test_random_graphs_keep_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is found in them, and however little it is worth."""
    monkeypatch.setattr(repeats, "LEAST", 3)
    monkeypatch.setattr(repeats, "WEIGHT", 0)
    found = 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        nodes = Nodes()
        pool = inputs(nodes, 6)
        for _ in range(3):
            offsets, ops = random.integers(1, 4, size=12), random.choice([*FOLD], size=12)
            new_nodes = []
            for _ in range(int(random.integers(2, 5))):
                own = [pool[int(k)] for k in random.integers(0, len(pool), size=3)]
                for op, offset in zip(ops.tolist(), offsets.tolist(), strict=True):
                    pair = [own[-1], own[-offset]]
                    own.append(nodes.intern(op, *pair[:: int(random.choice([1, -1]))]))
                new_nodes += own[-2:]
            pool += new_nodes
        results = [pool[-4:], pool[-6:-3]]
        parts: list[Part] = []
        outlined = outline_repeats(results, parts)
        found += len(parts)
        numbers = {f"s{k}": float(value) for k, value in enumerate(random.normal(size=6))}
        same = evaluate(outlined, parts, numbers), evaluate(results, [], numbers)
        np.testing.assert_array_equal(*map(np.concatenate, same), err_msg=str(seed))
    assert found > 20
