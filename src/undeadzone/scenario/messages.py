"""Messages about faulty scenario keys: the key first, with a suggestion if a known key is similar.

The messages are made of msgspec's.
"""

from __future__ import annotations

import re
import typing
from typing import Any

import msgspec

from undeadzone.errors import InputError
from undeadzone.registry import REGISTRIES
from undeadzone.util.installed import advise_on_arena
from undeadzone.util.toml import advise_on_name

_CURES = {  # admissible values of a part, if its type does not show them
    "plant": "uz.Plant(A=..., B=..., C=...), or uz.from_control(system)",
    "reference": "a signal such as uz.Sine(amplitude=..., frequency=...)",
    "observer": "options such as uz.Auto(right=[0.0, 2.0])",
    "compare": "options such as uz.Auto(right=[0.0, 2.0])",
    "controller": "options such as uz.StateFeedback()",
    "compensator": "options such as uz.SmoothZoneInverse()",
}
_WORDS = {
    "object": "a table",
    "dict": "a table",
    "array": "a list",
    "list": "a list",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "null": "nothing",
}
CHOOSERS = ("kind", "method")  # keys that choose among the variants of a table
_Structs = list[type[msgspec.Struct]]


def explain(message: str, data: dict[str, Any], root: type[msgspec.Struct]) -> str:
    """Return the message of a msgspec.ValidationError in a reader's words.

    Args:
        message: the message of the error. Each of several nested tables may have added its place to
            it.
        data: the tables that were read.
        root: the struct that they were read as.
    """
    body, *inner_first = message.split(" - at `$")
    path = "".join(part.rstrip("`") for part in reversed(inner_first))
    key = _entry(path.lstrip("."), data)
    unknown = re.match(r"(?s)Object contains unknown field `(.*)`", body)
    if unknown:
        name = unknown[1]
        advice = advise_on_name(name, _fields(root, key, data), "Known keys:")
        return f"{_join(key, name)}: unknown key. {advice}"
    missing = re.match(r"Object missing required field `(.*)`", body)
    if missing:
        return _missing(key, missing[1], root)
    invalid = re.match(r"(?s)Invalid (?:enum )?value '(.*)'", body)
    choices = _choices(root, key, data)
    if invalid and choices:
        return _unknown_choice(key, invalid[1], choices)
    body = re.sub(r"`([\w| ]+)`", _in_words, body)
    where = f"{key}: " if key else ""
    return f"{where}{body[:1].lower()}{body[1:]}".replace(", got ", ", found ")


def require_kind(key: str, value: Any, kind: Any) -> None:
    """Raise InputError if a part has another type, such as a name, a number or a class.

    Args:
        key: of the part.
        value: as a program may give it.
        kind: the expected type: a struct, options of methods, or a union of them (parts of other
            kinds are not checked).
    """
    kinds = typing.get_args(kind) or (kind,)
    tables = [each for each in kinds if each in REGISTRIES or hasattr(each, "__struct_fields__")]
    if tables and not any(_is_of(value, each) for each in kinds):
        cure = _CURES.get(key, f"uz.{tables[0].__name__}(...)")
        found = f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__
        raise InputError(f"{key}: expected {cure}, found {found}")


def _is_of(value: Any, kind: Any) -> bool:
    """Return whether a part is of a kind. An observer's options are not a controller's."""
    if kind not in REGISTRIES or isinstance(value, type) or not isinstance(value, kind):
        return isinstance(value, kind) and not isinstance(value, type)
    others = [one for each, one in REGISTRIES.items() if each is not kind]
    return not any(one.has_options(type(value)) for one in others)


def require_words(key: str, options: Any, kind: type[msgspec.Struct]) -> None:
    """Raise InputError if a field with fixed choices, as simulation.time, has an unknown value.

    Args:
        key: of the options.
        options: as a program may give them.
        kind: type of the options.
    """
    require_kind(key, options, kind)
    for field in msgspec.structs.fields(kind):
        words = typing.get_args(field.type)
        value = getattr(options, field.name)
        if typing.get_origin(field.type) is typing.Literal and value not in words:
            raise InputError(_unknown_choice(f"{key}.{field.name}", value, list(words)))


def _unknown_choice(key: str, word: Any, choices: list[str]) -> str:
    """Return the message about a word that is not a choice of a key."""
    advice = advise_on_name(str(word), choices, "Expected one of")
    elsewhere = advise_on_arena() if key.endswith(".method") else ""
    return f"{key}: unknown choice {word!r}. {advice}{elsewhere}"


def _missing(key: str, name: str, root: type[msgspec.Struct]) -> str:
    """Return the message about a key that is missing from the table at `key`."""
    text = f"{_join(key, name)}: missing. This key is required"
    choices = _tags(root, key) if name in CHOOSERS else []
    if choices:
        text += f" (one of {', '.join(choices)})"
    return text


def _choices(root: type[msgspec.Struct], key: str, data: dict[str, Any]) -> list[str]:
    """Return the words that may stand at a dotted key (empty if it does not choose among words)."""
    parent, _, name = key.rpartition(".")
    tags = _tags(root, parent) if name in CHOOSERS else []
    if tags:
        return tags
    words = []
    for struct in _chosen_variants(root, parent, data):
        annotation = typing.get_type_hints(struct).get(name)
        words += list(map(str, _literals(annotation)))
    return words


def _in_words(types: re.Match[str]) -> str:
    """Return the types that msgspec names, in a reader's words."""
    names = types[1].split(" | ")
    names = [name for name in names if name != "null"] or names
    return " or ".join(_WORDS.get(name, name) for name in names)


def _join(key: str, name: str) -> str:
    """Return the dotted key of a name in the table at `key`."""
    return f"{key}.{name}" if key else name or "''"


def _walk(key: str, data: Any) -> Any:
    """Return the value at a dotted key of the data, an empty table if it has none."""
    for part in filter(None, re.findall(r"[^.\[\]]+", key)):
        if isinstance(data, list):
            data = data[int(part)]
        elif isinstance(data, dict):
            data = data.get(part, {})
        else:
            data = {}
    return data


def _entry(key: str, data: Any) -> str:
    """Return the key of a wrong entry; if msgspec writes [...] for its name, with the name.

    It writes [...] in tables with arbitrary names. They may contain numbers only, so that the wrong
    entry is the first one that is not a number.
    """
    table, anonymous, _ = key.partition("[...]")
    if anonymous:
        for name, value in _walk(table, data).items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                return f"{table}.{name}"
    return key


def _structs(annotation: Any) -> _Structs:
    """Return the structs that an annotation allows."""
    if annotation in REGISTRIES:
        return [*REGISTRIES[annotation].list_options()]
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    structs: _Structs = []
    for part in typing.get_args(annotation):
        structs += _structs(part)
    return structs


def _literals(annotation: Any) -> list[Any]:
    """Return the words that an annotation allows."""
    if typing.get_origin(annotation) is typing.Literal:
        return list(typing.get_args(annotation))
    words = []
    for part in typing.get_args(annotation):
        words += _literals(part)
    return words


def _at(root: type[msgspec.Struct], key: str) -> _Structs:
    """Return the structs that may stand at a dotted key."""
    here: _Structs = [root]
    for part in filter(None, re.sub(r"\[[^\]]*\]", "", key).split(".")):
        below: _Structs = []
        for struct in here:
            below += _structs(typing.get_type_hints(struct).get(part))
        here = below
    return here


def _tags(root: type[msgspec.Struct], key: str) -> list[str]:
    """Return the names of the variants at a dotted key."""
    tags = [struct.__struct_config__.tag for struct in _at(root, key)]
    return [str(tag) for tag in tags if tag is not None]


def _chosen_variants(root: type[msgspec.Struct], key: str, data: dict[str, Any]) -> _Structs:
    """Return the variant at a dotted key that the data choose, or all that may stand there."""
    table = _walk(key, data)
    structs = _at(root, key)
    if not isinstance(table, dict):
        return structs
    chosen = list(map(table.get, CHOOSERS))
    return [struct for struct in structs if struct.__struct_config__.tag in chosen] or structs


def _fields(root: type[msgspec.Struct], key: str, data: dict[str, Any]) -> list[str]:
    """Return keys known at a dotted key, of the variant that the data choose if it has several."""
    names: list[str] = []
    choosers: list[str] = []
    for struct in _chosen_variants(root, key, data):
        names += struct.__struct_fields__
        config = struct.__struct_config__
        if config.tag is not None:
            choosers.append(str(config.tag_field))
    return list(dict.fromkeys(names + choosers))
