"""Names, docstrings and prose use the field's words: rates with ceilings that only fall.

`ceilings.toml` holds today's figure and the goal of each rate. A rate more than 2 % above its
ceiling fails. A rate more than 15 % below its ceiling fails as well, until the ceiling is lowered
in the same commit.

    python tests/rules/test_language.py               print all figures
    python tests/rules/test_language.py one word      print the worst places of matching figures
    python tests/rules/test_language.py --lower       lower the ceilings to today's figures
    python tests/rules/test_language.py --tree PATH   measure the code of another project
"""

from __future__ import annotations

import argparse
import ast
import functools
import gc
import math
import re
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import source_measures
import wording
from source_measures import COMPREHENSIONS, DOCUMENTED, FUNCTIONS, HOME, Source

CEILINGS = Path(__file__).with_name("ceilings.toml")
SLACK = 0.15  # share of a ceiling that a figure may lie below it
TOLERANCE = 0.02  # share that it may lie above: plain text that is removed raises all rates
HEAD = """\
# Rates of language: figure = [ceiling, goal]. Ceilings only fall, and none falls below its goal.
# Names and first lines are in percent, density in 1000 lines of code, prose in 1000 words.
# `python tests/rules/test_language.py --lower` writes this file. Empty lines between the rows let
# git merge branches that lower different rows.
"""
# Text about the paper's own statements, which are claims.
PAPER = ("docs/paper.md", "src/undeadzone_paper/")
FILES_OF_PROSE = {
    "README": "README.md",
    "docs": "docs/**/*.md",
    "KNOWN_GAPS": "KNOWN_GAPS.md",
    "CHANGELOG": "CHANGELOG.md",
}


class Place(NamedTuple):
    """A place that counts against a figure: its file, its line and the text there."""

    path: str
    line: int
    text: str

    def __str__(self) -> str:
        """Return the place as compilers print it."""
        return f"{self.path}:{self.line}: {self.text}"


class Figure(NamedTuple):
    """A rate, and the places behind it.

    Attributes:
        value: the rate.
        places: what counts against it.
        ranked: the places are in order, the worst first.
    """

    value: float
    places: list[Place]
    ranked: bool = False

    def list_worst(self, count: int) -> list[Place]:
        """Return the worst places; unless they are ranked, those of the worst files."""
        if self.ranked:
            return self.places[:count]
        files = Counter(place.path for place in self.places)
        return sorted(self.places, key=lambda place: (-files[place.path], place))[:count]


class Passage(NamedTuple):
    """A piece of prose: its file, its first line and its text."""

    path: str
    line: int
    text: str


# Names.


def select_functions(source: Source) -> list[ast.FunctionDef]:
    """Return the functions and methods of a file but those that Python names."""
    return [node for node in source.select(*FUNCTIONS) if not node.name.startswith("__")]


def measure_names(sources: Sequence[Source]) -> dict[str, Figure]:
    """Measure the names of functions: one word, participles, search, uniqueness."""
    named = [
        Place(source.path, node.lineno, node.name)
        for source in sources
        for node in select_functions(source)
    ]
    single = [place for place in named if len(wording.split_name(place.text)) == 1]
    participles = [place for place in named if wording.is_participle(place.text)]
    shared, share = find_shared_names(sources)
    return {
        "names: one word": Figure(percent(single, named), single),
        "names: participles": Figure(percent(participles, named), participles),
        "names: words met in a search, mean": measure_search(sources, named),
        "names: public functions not unique in their package": Figure(share, shared, ranked=True),
    }


def measure_search(sources: Sequence[Source], named: list[Place]) -> Figure:
    """Measure the words that a search for a function meets for each definition of the name."""
    words = Counter[str]()
    for source in sources:
        words.update(re.findall(r"[A-Za-z_]\w*", source.text))
    definitions = Counter(place.text for place in named)
    first = {place.text: place for place in reversed(named)}
    costly = sorted(definitions, key=lambda name: -words[name])
    places = [
        first[name]._replace(text=f"{name}: {words[name]} words, {definitions[name]} definitions")
        for name in costly
    ]
    return Figure(
        sum(words[name] for name in definitions) / max(1, len(named)), places, ranked=True
    )


def find_shared_names(sources: Sequence[Source]) -> tuple[list[Place], float]:
    """Find public functions of modules that share their name with others of the same package.

    Returns:
        The places, and their share of all public functions of modules [%].
    """
    same = defaultdict[tuple[str, str], list[Place]](list)
    for source in sources:
        (module,) = source.select(ast.Module)
        for node in module.body:
            if isinstance(node, FUNCTIONS) and not node.name.startswith("_"):
                package = source.path.removeprefix("src/").split("/")[0]
                same[package, node.name].append(Place(source.path, node.lineno, node.name))
    groups = sorted((places for places in same.values() if len(places) > 1), key=len, reverse=True)
    shared = [place for places in groups for place in places]
    return shared, percent(shared, [place for places in same.values() for place in places])


def percent(part: list[Any], whole: list[Any]) -> float:
    """Return the size of a part in percent of the whole, 0 if the whole is empty."""
    return 100 * len(part) / max(1, len(whole))


# First lines of docstrings.


def measure_first_lines(sources: Sequence[Source]) -> dict[str, Figure]:
    """Measure the first lines of docstrings: riddles, vague words, verbs."""
    lines, of_functions = [], []
    for source in sources:
        for node in source.select(*DOCUMENTED):
            text = (ast.get_docstring(node, clean=False) or "").strip()
            if text:
                line = Place(source.path, first_line_number(node), text.splitlines()[0])
                lines.append(line)
                if isinstance(node, FUNCTIONS):
                    of_functions.append(line)
    riddles = [line for line in lines if wording.RIDDLE.match(line.text)]
    vague = [line for line in lines if len(wording.VAGUE.findall(line.text)) > 1]
    no_verb = [line for line in lines if not wording.is_imperative(line.text)]
    no_verb_of_functions = [line for line in of_functions if not wording.is_imperative(line.text)]
    return {
        "docstrings: begin What, Which, Whether, How, Where, Why": Figure(
            percent(riddles, lines), riddles
        ),
        "docstrings: two vague words": Figure(percent(vague, lines), vague),
        "docstrings: no verb first": Figure(percent(no_verb, lines), no_verb),
        "docstrings: functions with no verb first": Figure(
            percent(no_verb_of_functions, of_functions), no_verb_of_functions
        ),
    }


def first_line_number(node: Any) -> int:
    """Return the line on which the docstring of a node begins."""
    return int(node.body[0].lineno)


# Density of the code.


def measure_density(sources: Sequence[Source]) -> dict[str, Figure]:
    """Measure how much a line of code holds: budgets count nodes, so dense lines gain nothing."""
    code = {source.path: source_measures.count_code_lines(source) for source in sources}
    total = max(1, sum(code.values()))
    dense = sorted(sources, key=lambda source: -source.size / max(30, code[source.path]))
    figures = {
        "density: nodes in a line": Figure(
            sum(source.size for source in sources) / total,
            [
                Place(source.path, 1, f"{source.size} nodes, {code[source.path]} lines")
                for source in dense
            ],
            ranked=True,
        )
    }
    kinds = {
        "comprehensions": lambda source: source.select(*COMPREHENSIONS),
        "conditional expressions": lambda source: source.select(ast.IfExp),
        "tuple assignments": select_tuple_assignments,
    }
    for kind, select in kinds.items():
        places = [
            Place(source.path, node.lineno, source.text.splitlines()[node.lineno - 1].strip())
            for source in sources
            for node in select(source)
        ]
        figures[f"density: {kind}"] = Figure(1000 * len(places) / total, places)
    return figures


def select_tuple_assignments(source: Source) -> list[ast.Assign]:
    """Return the assignments of several values at once, `a, b = x, y`."""
    return [
        node
        for node in source.select(ast.Assign)
        if isinstance(node.value, ast.Tuple) and isinstance(node.targets[0], ast.Tuple)
    ]


# Prose.


def measure_prose(kind: str, passages: list[Passage]) -> dict[str, Figure]:
    """Measure the habits of a kind of prose in 1000 words."""
    figures = {}
    for habit, pattern in wording.PATTERNS.items():
        read = [passage for passage in passages if not is_exempt(habit, passage.path)]
        words = sum(len(re.findall(r"[A-Za-z][A-Za-z'-]*", passage.text)) for passage in read)
        places = [place for passage in read for place in find_places(pattern, passage)]
        figures[f"{kind}: {habit}"] = Figure(1000 * len(places) / max(1, words), places)
    return figures


def is_exempt(habit: str, path: str) -> bool:
    """Test if a habit is right in a file: claims are what the paper's own text is about."""
    return habit == "claim" and path.startswith(PAPER)


def find_places(pattern: re.Pattern[str], passage: Passage) -> Iterator[Place]:
    """Yield the places of a passage that a pattern matches."""
    for match in pattern.finditer(passage.text):
        before = passage.text[: match.start()].count("\n")
        line = passage.text.splitlines()[before].strip()
        yield Place(passage.path, passage.line + before, line)


def read_pages(pattern: str) -> list[Passage]:
    """Read the prose of pages whose path matches a pattern."""
    passages = []
    for path in sorted(HOME.glob(pattern)):
        text = wording.strip_markdown(path.read_text(encoding="utf-8"))
        passages.append(Passage(path.relative_to(HOME).as_posix(), 1, text))
    return passages


def select_docstrings(source: Source) -> list[Passage]:
    """Return the docstrings of a file."""
    return [
        docstring_passage(source, node)
        for node in source.select(*DOCUMENTED)
        if ast.get_docstring(node, clean=False)
    ]


def docstring_passage(source: Source, node: Any) -> Passage:
    """Return the prose of a node's docstring."""
    text = wording.strip_docstring(ast.get_docstring(node, clean=False) or "")
    return Passage(source.path, first_line_number(node), text)


def select_help(source: Source) -> list[Passage]:
    """Return the help of a file's commands: docstrings of commands, and arguments `help`."""
    passages = [
        Passage(source.path, keyword.lineno, text)
        for keyword in source.select(ast.keyword)
        if keyword.arg in ("help", "short_help", "epilog")
        for text in join_strings(keyword.value)
    ]
    for node in source.select(*FUNCTIONS):
        command = any("command" in ast.unparse(mark) for mark in node.decorator_list)
        if command and ast.get_docstring(node):
            passages.append(docstring_passage(source, node))
    return passages


def select_messages(source: Source) -> list[Passage]:
    """Return the texts that a file prints or raises: sentences that are no docstring, no code."""
    inner = {id(node.value) for node in source.select(ast.Expr)}
    for node in source.select(ast.JoinedStr):
        inner |= {id(part) for part in ast.walk(node)} - {id(node)}
    texts = [
        (node.lineno, wording.strip_code_words("".join(join_strings(node))))
        for node in source.select(ast.Constant, ast.JoinedStr)
        if id(node) not in inner
    ]
    return [Passage(source.path, line, text) for line, text in texts if wording.is_prose(text)]


def join_strings(node: ast.AST) -> list[str]:
    """Return the texts of an expression, with an X for each value that an f-string inserts."""
    if isinstance(node, ast.Constant):
        return [node.value] if isinstance(node.value, str) else []
    texts = [text for child in ast.iter_child_nodes(node) for text in join_strings(child)]
    if isinstance(node, ast.JoinedStr):
        return ["".join(texts)]
    return ["X"] if isinstance(node, ast.FormattedValue) else texts


# All figures.


@functools.cache
def measure_project() -> dict[str, Figure]:
    """Measure this project."""
    sources = [
        source._replace(path=f"src/{source.path}") for source in source_measures.read_sources()
    ]
    figures = measure_code(sources)
    for kind, pattern in FILES_OF_PROSE.items():
        figures |= measure_prose(kind, read_pages(pattern))
    selections = {"help": select_help, "messages": select_messages, "docstrings": select_docstrings}
    for kind, select in selections.items():
        passages = [passage for source in sources for passage in select(source)]
        figures |= measure_prose(kind, passages)
    return figures


def measure_code(sources: Sequence[Source]) -> dict[str, Figure]:
    """Measure the figures that any project in Python has."""
    return measure_names(sources) | measure_first_lines(sources) | measure_density(sources)


# Ceilings.


def read_ceilings() -> dict[str, tuple[float, float]]:
    """Read the ceiling and the goal of each figure."""
    table = tomllib.loads(CEILINGS.read_text(encoding="utf-8"))
    return {name: (ceiling, goal) for name, (ceiling, goal) in table.items()}


def write_ceilings(ceilings: dict[str, tuple[float, float]]) -> None:
    """Write `ceilings.toml`."""
    rows = [f'"{name}" = [{ceiling:g}, {goal:g}]\n' for name, (ceiling, goal) in ceilings.items()]
    CEILINGS.write_text("\n".join([HEAD, *rows]), encoding="utf-8")


def round_up(value: float) -> float:
    """Round a figure up to two decimals, from 10 on to one."""
    scale = 10 if value >= 10 else 100
    return math.ceil(round(scale * value, 6)) / scale


def lower_ceiling(value: float, ceiling: float, goal: float) -> float:
    """Return the ceiling lowered to a figure; it never rises, and it stays at its goal."""
    return min(ceiling, max(round_up(value), goal))


def is_above(value: float, ceiling: float) -> bool:
    """Test if a figure is above its ceiling by more than the tolerance."""
    return value > (1 + TOLERANCE) * ceiling


def is_loose(value: float, ceiling: float, goal: float) -> bool:
    """Test if a figure lies so far below its ceiling that the ceiling must be lowered."""
    return lower_ceiling(value, ceiling, goal) < (1 - SLACK) * ceiling


# Tests of the project.


def test_every_figure_has_a_ceiling() -> None:
    assert measure_project().keys() == read_ceilings().keys()


def test_no_figure_is_above_its_ceiling() -> None:
    """Rephrase what you added. No command raises a ceiling."""
    above = []
    for name, (ceiling, _) in read_ceilings().items():
        figure = measure_project()[name]
        if is_above(figure.value, ceiling):
            worst = "\n".join(f"    {place}" for place in figure.list_worst(10))
            above.append(f"{name}: {figure.value:.2f}, at most {ceiling:g}\n{worst}")
    assert not above, "\n" + "\n".join(above)


def test_ceilings_follow_their_figures_down() -> None:
    loose = [
        f"{name}: ceiling {ceiling:g}, today {measure_project()[name].value:.2f}"
        for name, (ceiling, goal) in read_ceilings().items()
        if is_loose(measure_project()[name].value, ceiling, goal)
    ]
    assert not loose, "run python tests/rules/test_language.py --lower\n" + "\n".join(loose)


# Tests of the measures.


@pytest.mark.parametrize(
    ("habit", "text"),
    [
        ("told, hear, ask, say", "The filter is told the variance."),
        ("told, hear, ask, say", "It says nothing."),
        ("claim", "The claims hold."),
        ("what-clauses", "It shows what\nis left."),
        ("is no, none of, nor", "That is no limit."),
        ("where for if", "Where a zone is wide, the filter waits."),
        ("decimals without 0", "coverage of .95"),
        ("semicolons", "It is one; it is two."),
    ],
)
def test_a_habit_is_found(habit: str, text: str) -> None:
    found = [name for name, pattern in wording.PATTERNS.items() if pattern.search(text)]
    assert found == [habit]


@pytest.mark.parametrize(
    "text",
    [
        "The filter assumes a variance of 0.25, as 3.4.5 and file.1 have it.",
        "Use the estimate if the sensor is in the zone.",
        "An essay of a storyteller, a shearing force and a task",
        "Proclaimed values are not used. There is no reading. The result is not a bound.",
        "The place where x lies",
    ],
)
def test_plain_sentences_have_no_habit(text: str) -> None:
    assert not [name for name, pattern in wording.PATTERNS.items() if pattern.search(text)]


def test_rates_of_prose_count_words_and_lines() -> None:
    passage = Passage("docs/x.md", 7, "one two three\nfour; five")
    figure = measure_prose("docs", [passage])["docs: semicolons"]
    assert figure.value == pytest.approx(200)
    assert [str(place) for place in figure.places] == ["docs/x.md:8: four; five"]


def test_the_worst_file_comes_first() -> None:
    lines = [Place("a", 1, ""), Place("b", 2, ""), Place("b", 1, "")]
    assert Figure(1, lines).list_worst(2) == [lines[2], lines[1]]
    assert Figure(1, lines, ranked=True).list_worst(2) == lines[:2]


def test_the_paper_may_claim() -> None:
    passages = [Passage("docs/paper.md", 1, "A claim"), Passage("docs/model.md", 1, "A model")]
    figures = measure_prose("docs", passages)
    assert figures["docs: claim"].value == 0
    assert measure_prose("docs", [Passage("docs/x.md", 1, "A claim")])["docs: claim"].value == 500


@pytest.mark.parametrize("name", ["heard", "_kept", "heard_edges", "fitted_with_delay", "taken_in"])
def test_a_participle_is_found(name: str) -> None:
    assert wording.is_participle(name)


@pytest.mark.parametrize(
    "name",
    ["speed", "need_model", "embed", "bed", "read_log", "split_name", "left_edge", "", "fit"],
)
def test_other_names_are_no_participles(name: str) -> None:
    assert not wording.is_participle(name)


@pytest.mark.parametrize(
    "line", ["Return the gain.", "State the order.", "List all files.", "Linearise f about x."]
)
def test_a_verb_in_the_imperative_is_found(line: str) -> None:
    assert wording.is_imperative(line)


@pytest.mark.parametrize(
    "line",
    ["Returns the gain.", "State of z.", "State vector", "Order.", "The gain", "Poles", "", "(n)"],
)
def test_other_first_words_are_no_verbs(line: str) -> None:
    assert not wording.is_imperative(line)


def test_word_lists_are_consistent() -> None:
    assert wording.WORDS["also_nouns"] < wording.WORDS["verbs"]
    assert not wording.WORDS["followers"] & wording.WORDS["verbs"]


PAGE = """\
# Title with `code; code`

Text with [a link](https://x.y/z;z), $a; b$ and
![a picture; of it](x.png) text.

| told | heard |
|---|---|

    told = 1

    heard = 2

* item
    * inner item
      goes on

```
told; heard
```
<!-- claim -->
The end &nbsp;
"""


def test_pages_lose_code_tables_and_formulas() -> None:
    lines = [line.strip() for line in wording.strip_markdown(PAGE).splitlines()]
    assert [line for line in lines if line] == [
        "# Title with X",
        "Text with a link, X and",
        "text.",
        "* item",
        "* inner item",
        "goes on",
        "The end",
    ]
    assert lines.index("The end") == PAGE.splitlines().index("The end &nbsp;")


def test_docstrings_lose_examples() -> None:
    text = "Return `x; y`.\n\n>>> f(1); f(2)\n3\n\nArgs:\n    x: number"
    assert wording.strip_docstring(text) == "Return X.\n\n\n\n\nArgs:\n    x: number"


CODE = '''\
"""What one is of another."""

import os


class State:
    """State of a filter."""

    def told(self) -> int:
        """What is told."""
        return 1


def run():
    """Run a loop, told of `x`."""
    a, b = 1, 2
    for c in [d for d in range(3)]:
        told = c if c else b
    raise ValueError(f"{a:.2f} is told; use much less" + "give a little more")


@click.command(help="Ask it.")
def run():
    """Say it."""
    return """
# text

"""
'''


def test_names_and_first_lines_are_measured() -> None:
    figures = measure_code([source_measures.parse_source("src/one/code.py", CODE)])
    values = {name: round(figure.value, 2) for name, figure in figures.items()}
    assert values["names: one word"] == 100
    assert values["names: participles"] == 33.33
    assert values["names: words met in a search, mean"] == round((5 + 2) / 3, 2)
    assert values["names: public functions not unique in their package"] == 100
    assert values["docstrings: begin What, Which, Whether, How, Where, Why"] == 40
    assert values["docstrings: two vague words"] == 40
    assert values["docstrings: no verb first"] == 60
    assert values["docstrings: functions with no verb first"] == 33.33


def test_density_is_measured() -> None:
    source = source_measures.parse_source("src/one/code.py", CODE)
    lines = source_measures.count_code_lines(source)
    assert lines == 15
    figures = measure_density([source])
    for kind in ("comprehensions", "conditional expressions", "tuple assignments"):
        assert figures[f"density: {kind}"].value == pytest.approx(1000 / lines)
    assert figures["density: nodes in a line"].value == pytest.approx(source.size / lines)


def test_help_and_messages_are_read() -> None:
    source = source_measures.parse_source("src/one/code.py", CODE)
    assert [passage.text for passage in select_help(source)] == ["Ask it.", "Say it."]
    texts = [passage.text for passage in select_messages(source)]
    assert sorted(texts) == ["X is told; use much less", "give a little more"]


def test_ceilings_fall_and_stop_at_the_goal() -> None:
    assert lower_ceiling(61.234, 72, 45) == 61.3
    assert lower_ceiling(6.123, 72, 1) == 6.13
    assert lower_ceiling(73, 72, 45) == 72
    assert lower_ceiling(30, 72, 45) == 45
    assert is_above(74, 72)
    assert not is_above(73, 72)
    assert is_above(0.01, 0)
    assert is_loose(61, 72, 45)
    assert not is_loose(62, 72, 45)
    assert not is_loose(1, 45, 45)


# The command.


def main() -> int:
    """Print or lower figures."""
    parser = argparse.ArgumentParser(description="Measure the language of code and pages.")
    parser.add_argument("figure", nargs="*", help="Print the worst places of matching figures.")
    parser.add_argument("--count", type=int, default=20, help="Number of places to print.")
    parser.add_argument("--lower", action="store_true", help="Lower the ceilings to the figures.")
    parser.add_argument("--tree", type=Path, help="Source folder of another project.")
    options = parser.parse_args()
    gc.disable()
    if options.tree:
        figures = measure_code(source_measures.read_sources(options.tree.resolve()))
    else:
        figures = measure_project()
    ceilings = {} if options.tree else read_ceilings()
    if options.lower:
        ceilings = {
            name: (lower_ceiling(figures[name].value, ceiling, goal), goal)
            for name, (ceiling, goal) in ceilings.items()
        }
        write_ceilings(ceilings)
    requested = " ".join(options.figure)
    for name, figure in figures.items():
        if requested in name:
            sys.stdout.write(format_figure(name, figure.value, ceilings.get(name)))
            for place in figure.list_worst(options.count if requested else 0):
                sys.stdout.write(f"    {place}\n")
    return int(any(is_above(figures[name].value, limit) for name, (limit, _) in ceilings.items()))


def format_figure(name: str, value: float, limits: tuple[float, float] | None) -> str:
    """Format a figure as a line, with its ceiling and its goal."""
    more = f"  ceiling {limits[0]:6.2f}  goal {limits[1]:6.2f}" if limits else ""
    return f"{name:60}{value:8.2f}{more}\n"


if __name__ == "__main__":
    sys.exit(main())
