"""Writes docs/scenario*.md from the structs that read a scenario, so that they cannot fall behind.

Run: python docs/reference.py
"""

from __future__ import annotations

import inspect
import re
import typing
from pathlib import Path

import msgspec

from undeadzone.registry import REGISTRIES
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Array

DOCS = Path(__file__).parent
FIRST = "scenario"
PAGES = {  # table: the page that begins with it or has it too, in place of the first
    "plant": "scenario_plant",
    "reference": "scenario_plant",
    "observer": "scenario_observer",
    "controller": "scenario_controller",
    "compensator": "scenario_controller",
    "ensemble": "scenario_studies",
    "tune": "scenario_studies",
}
LIMIT = 2900  # words of a page; a table with more variants goes on to a second one
ENTRY = re.compile(r"    (\w[\w, ]*): (.*)")
HEAD = """# The scenario file

Which keys may stand in a scenario, what each means, and what happens without it. `undeadzone init`
writes a commented file to start from. `python docs/reference.py` writes the pages from the structs
that read the file. Numbers are SI, times in seconds; *n* is the number of states, *m* of inputs,
*p* of outputs. An *array* is a number or (nested) lists of numbers. Where a table has variants, the
key in bold chooses one.
"""


def pages() -> dict[Path, str]:
    """Return the pages by their files."""
    blocks: dict[str, list[str]] = {FIRST: []}
    for name, texts in tables().items():
        blocks.setdefault(PAGES.get(name, FIRST), []).extend(texts)
    written: dict[str, str] = {}
    for stem, texts in blocks.items():
        for number, text in enumerate(paginate(texts), 1):
            name = stem if number == 1 else f"{stem}_{number}"
            written[name] = text if stem == FIRST else f"{title(name)}\n{text}"
    listed = [f"* [{title(name)[2:-1]}]({name}.md)" for name in written if name != FIRST]
    written[FIRST] = "\n".join([HEAD, *listed, "", written[FIRST]])
    return {DOCS / f"{name}.md": text for name, text in written.items()}


def title(name: str) -> str:
    """Return the heading of a page."""
    words = [table for table, page in PAGES.items() if name.startswith(page)]
    number = re.search(r"\d+$", name)
    return f"# Scenario file: {', '.join(words)}{f', part {number[0]}' if number else ''}\n"


def paginate(texts: list[str]) -> list[str]:
    """Return texts joined to pages that are not longer than the limit."""
    joined: list[list[str]] = [[]]
    for text in texts:
        if len(" ".join([*joined[-1], text]).split()) > LIMIT:
            joined.append([])
        joined[-1].append(text)
    return ["\n".join(part) for part in joined]


def tables() -> dict[str, list[str]]:
    """Return the section of each table of a scenario: its head, and each of its variants."""
    top = msgspec.structs.fields(Scenario)
    meanings = meaning(Scenario)
    simple = [field for field in top if not structs(field.type)]
    parts = {"": ["## Top level\n", rows(simple, meanings)]}
    described: dict[tuple[type, ...], str] = {}
    for field in top:
        kinds = tuple(structs(field.type))
        if not kinds:
            continue
        texts = parts.setdefault(field.name, [])
        if kinds in described:
            place = described[kinds]
            texts += [f"## [{field.name}]\n", f"{meanings[field.name]}\n"]
            link = f"{PAGES.get(place, FIRST)}.md#{place}"
            texts += [f"Its keys are those of [[{place}]]({link}).\n"]
            continue
        described[kinds] = field.name
        if len(kinds) > 1:
            texts += [f"## [{field.name}]\n", f"{meanings[field.name]}\n", variants(kinds)]
        for struct in kinds:
            texts.append("\n".join(table(field.name, struct, alone=len(kinds) == 1)))
    return parts


def variants(kinds: tuple[type[msgspec.Struct], ...]) -> str:
    """One line that names the variants of a table."""
    names = [f"`{struct.__struct_config__.tag}`" for struct in kinds]
    return f"Its variants: {', '.join(names)}.\n"


def table(name: str, struct: type[msgspec.Struct], alone: bool) -> list[str]:
    """The section of one table, or of one variant of it, and the tables inside it."""
    level = "##" if alone else "###"
    fields = msgspec.structs.fields(struct)
    parts = [f"{level} [{name}]{chooser(struct)}\n", f"{prose(struct)}\n"]
    if fields:
        parts.append(rows(fields, meaning(struct)))
    for part in inside(name, struct):
        if part not in parts:  # variants share tables
            parts.append(part)
    return parts


def inside(name: str, struct: type[msgspec.Struct]) -> list[str]:
    """The tables inside of one, and those inside of these."""
    parts = []
    for inner in msgspec.structs.fields(struct):
        for nested in structs(inner.type):
            where = f"{name}.{inner.name}"
            parts.append(f"`{where}`{chooser(nested)}: {prose(nested)}\n")
            if msgspec.structs.fields(nested):
                parts.append(rows(msgspec.structs.fields(nested), meaning(nested)))
            parts += inside(where, nested)
    return parts


def structs(annotation: typing.Any) -> list[type[msgspec.Struct]]:
    """The structs that an annotation allows."""
    if annotation in REGISTRIES:
        return [*REGISTRIES[annotation].list_options()]
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    found = []
    for part in typing.get_args(annotation):
        found += structs(part)
    return found


def chooser(struct: type[msgspec.Struct]) -> str:
    """How a variant is chosen, for the heading."""
    config = struct.__struct_config__
    return f" **{config.tag_field}** = {config.tag!r}" if config.tag is not None else ""


def prose(struct: type[msgspec.Struct]) -> str:
    """Return a struct's docstring before its sections on one line, with its DOIs as links."""
    text = re.split(r"\n(?:Attributes|Example|See Also):", inspect.getdoc(struct) or "")[0]
    line = " ".join(text.split())
    return re.sub(r"doi:(\S*\w)", r"[doi:\1](https://doi.org/\1)", line)


def meaning(struct: type[msgspec.Struct]) -> dict[str, str]:
    """What the docstring says of each field, inherited fields too."""
    entries: dict[str, str] = {}
    for kind in reversed(struct.__mro__):
        if kind.__dict__.get("__doc__"):
            entries |= attributes(inspect.cleandoc(kind.__dict__["__doc__"]))
    return entries


def attributes(docstring: str) -> dict[str, str]:
    """The entries of a section `Attributes:`, `name: text` or `name, name: text`.

    Lines that are indented deeper continue an entry.
    """
    _, _, section = docstring.partition("\nAttributes:\n")
    entries: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        if line and not line.startswith(" "):
            break
        start = ENTRY.match(line)
        if start:
            names = [name.strip() for name in start[1].split(",")]
            entries |= dict.fromkeys(names, start[2])
        elif line.strip():
            for name in names:
                entries[name] += " " + line.strip()
    return entries


def rows(fields: typing.Iterable[msgspec.structs.FieldInfo], meanings: dict[str, str]) -> str:
    """A table of keys, meanings, types and defaults."""
    lines = ["| key | meaning | type | default |", "|---|---|---|---|"]
    for field in fields:
        cells = (field.encode_name, meanings.get(field.name, ""), kind(field.type), default(field))
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def default(field: msgspec.structs.FieldInfo) -> str:
    """A field's default in words."""
    if field.required:
        return "required"
    value = default_of(field)
    return "none" if value is None else repr(value)


def default_of(field: msgspec.structs.FieldInfo) -> typing.Any:
    """A field's default value; tables show as {}."""
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    return {} if isinstance(value, msgspec.Struct) else value


def kind(annotation: typing.Any) -> str:
    """A type in the words of TOML."""
    plain = {
        float: "number",
        int: "whole number",
        str: "text",
        bool: "true or false",
        Array: "array",
        typing.Any: "formulas",
        type(None): "none",
    }
    if annotation in plain:
        return plain[annotation]
    if typing.get_origin(annotation) is typing.Literal:
        return " or ".join(repr(value) for value in typing.get_args(annotation))
    if structs(annotation):
        return "list of tables" if typing.get_origin(annotation) is list else "table"
    parts = [kind(part) for part in typing.get_args(annotation)]
    if typing.get_origin(annotation) is tuple:
        return f"list of {len(parts)} {parts[0]}s"
    if typing.get_origin(annotation) is list:
        return f"list of ({parts[0]})" if " or " in parts[0] else f"list of {parts[0]}"
    if typing.get_origin(annotation) is dict:
        return f"table of {parts[1]}"
    return " or ".join(part for part in parts if part != "none")


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
