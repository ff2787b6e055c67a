"""What is wrong with a scenario's words: msgspec's messages with the key first and a suggestion where one is near."""

from __future__ import annotations

import difflib
import re
import typing
from typing import Any

import msgspec

_WORDS = {
    "object": "a table", "dict": "a table", "array": "a list", "list": "a list", "float": "a number", "int": "a whole number",
    "str": "text", "bool": "true or false", "null": "nothing",
}  # fmt: skip
_Structs = list[type[msgspec.Struct]]


def explain(message: str, data: dict[str, Any], root: type[msgspec.Struct]) -> str:
    """The message of a msgspec.ValidationError about `data`, read as `root`, in a reader's words."""
    body, _, path = message.partition(" - at `$")
    key = _entry(path.rstrip("`").lstrip("."), data)
    parent, _, name = key.rpartition(".")
    if found := re.match(r"(?s)Object contains unknown field `(.*)`", body):
        return f"{_join(key, found[1])}: unknown key; {_advice(found[1], _fields(root, key, data), 'known keys:')}"
    if found := re.match(r"Object missing required field `(.*)`", body):
        choices = _tags(root, key) if found[1] in ("kind", "method") else []
        return f"{_join(key, found[1])}: missing; this key is required" + (
            f" (one of {', '.join(choices)})" if choices else ""
        )
    choices = _tags(root, parent) if name in ("kind", "method") else []
    choices = choices or [
        str(word) for hint in _hints(root, parent, name, data) for word in _literals(hint)
    ]
    if choices and (found := re.match(r"(?s)Invalid (?:enum )?value '(.*)'", body)):
        return (
            f"{key}: unknown choice {found[1]!r}; {_advice(found[1], choices, 'expected one of')}"
        )
    body = re.sub(
        r"`([\w| ]+)`",
        lambda types: " or ".join(_WORDS.get(word, word) for word in _alternatives(types[1])),
        body,
    )
    return f"{key and key + ': '}{body[:1].lower()}{body[1:]}".replace(", got ", ", found ")


def _alternatives(types: str) -> list[str]:
    words = types.split(" | ")
    return [word for word in words if word != "null"] or words


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name or "''"


def _advice(name: str, known: list[str], otherwise: str) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f"did you mean {near[0]!r}?" if near else f"{otherwise} {', '.join(sorted(known))}"


def _walk(key: str, data: Any) -> Any:
    """What stands at a dotted key of the data; an empty table where nothing does."""
    for part in filter(None, re.findall(r"[^.\[\]]+", key)):
        data = (
            data[int(part)]
            if isinstance(data, list)
            else data.get(part, {})
            if isinstance(data, dict)
            else {}
        )
    return data


def _entry(key: str, data: Any) -> str:
    """The key with the name of the entry that is no number, where msgspec says [...]: only tables of numbers have free names."""
    table, found, _ = key.partition("[...]")
    wrong = (
        [
            name
            for name, value in _walk(table, data).items()
            if isinstance(value, bool) or not isinstance(value, int | float)
        ]
        if found
        else []
    )
    return f"{table}.{wrong[0]}" if wrong else key


def _structs(annotation: Any) -> _Structs:
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    return [found for part in typing.get_args(annotation) for found in _structs(part)]


def _literals(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) is typing.Literal:
        return list(typing.get_args(annotation))
    return [word for part in typing.get_args(annotation) for word in _literals(part)]


def _hints(root: type[msgspec.Struct], key: str, name: str, data: dict[str, Any]) -> list[Any]:
    """The annotations that a field may have in the structs at a dotted key."""
    return [
        hints[name]
        for struct in _chosen(root, key, data)
        if name in (hints := typing.get_type_hints(struct))
    ]


def _at(root: type[msgspec.Struct], key: str) -> _Structs:
    """The structs that may stand at a dotted key."""
    here: _Structs = [root]
    for part in filter(None, re.sub(r"\[[^\]]*\]", "", key).split(".")):
        here = [
            found for struct in here for found in _structs(typing.get_type_hints(struct).get(part))
        ]
    return here


def _tags(root: type[msgspec.Struct], key: str) -> list[str]:
    return [
        str(struct.__struct_config__.tag)
        for struct in _at(root, key)
        if struct.__struct_config__.tag is not None
    ]


def _chosen(root: type[msgspec.Struct], key: str, data: dict[str, Any]) -> _Structs:
    """The variant at a dotted key that the data choose, or all that may stand there."""
    here, structs = _walk(key, data), _at(root, key)
    return [
        s
        for s in structs
        if isinstance(here, dict)
        and s.__struct_config__.tag in (here.get("kind"), here.get("method"))
    ] or structs


def _fields(root: type[msgspec.Struct], key: str, data: dict[str, Any]) -> list[str]:
    """Keys known at a dotted key, of the variant that the data choose where there are several."""
    chosen = _chosen(root, key, data)
    names = [field for struct in chosen for field in struct.__struct_fields__]
    return list(
        dict.fromkeys(
            names
            + [
                str(s.__struct_config__.tag_field)
                for s in chosen
                if s.__struct_config__.tag is not None
            ]
        )
    )
