"""Writes docs/scenario.md from the structs that read a scenario, so that the page cannot fall behind them.

Run: python docs/reference.py
"""

from __future__ import annotations

import typing
from pathlib import Path

import msgspec

from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import Array

PAGE = Path(__file__).with_name("scenario.md")
HEAD = """# The scenario file

`undeadzone init` writes a commented one to start from. This page lists every key; it is written by
`python docs/reference.py` from the structs that read the file. Numbers are SI, times in seconds. An *array* is a number
or (nested) lists of numbers. Where a table has variants, the key in bold chooses one.
"""


def page() -> str:
    """The whole page."""
    top = msgspec.structs.fields(Scenario)
    simple = [field for field in top if not structs(field.type)]
    parts = [HEAD, "## Top level\n", rows(simple)]
    for field in top:
        for struct in structs(field.type):
            parts += [
                f"## [{field.name}]{chooser(struct)}\n",
                f"{prose(struct)}\n",
                rows(msgspec.structs.fields(struct)),
            ]
            for inner in msgspec.structs.fields(struct):
                for nested in structs(inner.type):
                    parts += [
                        f"`{field.name}.{inner.name}`{chooser(nested)}: {prose(nested)}\n",
                        rows(msgspec.structs.fields(nested)),
                    ]
    return "\n".join(parts)


def structs(annotation: typing.Any) -> list[type[msgspec.Struct]]:
    """The structs that an annotation allows."""
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    return [found for part in typing.get_args(annotation) for found in structs(part)]


def chooser(struct: type[msgspec.Struct]) -> str:
    """How a variant is chosen, for the heading."""
    config = struct.__struct_config__
    return f" **{config.tag_field}** = {config.tag!r}" if config.tag is not None else ""


def prose(struct: type[msgspec.Struct]) -> str:
    """The struct's docstring on one line."""
    return " ".join((struct.__doc__ or "").split())


def rows(fields: typing.Iterable[msgspec.structs.FieldInfo]) -> str:
    """A table of keys, types and defaults."""
    lines = ["| key | type | default |", "|---|---|---|"]
    for field in fields:
        default = (
            "required"
            if field.required
            else "none"
            if field.default is None
            else repr(default_of(field))
        )
        lines.append(f"| {field.name} | {kind(field.type)} | {default} |")
    return "\n".join(lines) + "\n"


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
        return f"list of {parts[0]}"
    if typing.get_origin(annotation) is dict:
        return f"table of {parts[1]}"
    return " or ".join(part for part in parts if part != "none")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
