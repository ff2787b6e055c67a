"""Changes of a scenario's tables by the types that read them: one key, seldom more, at a time."""

from __future__ import annotations

import copy
import random
import typing
from typing import Any, Final

import msgspec

from tools.fuzz.damage import TEXTS, anything, number
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Array

# Keys by which anybody may ask for a long computation, and what is not asked for here.
LENGTHS: Final = {
    "duration": (1e-3, 2.0),
    "step": (5e-3, 0.5),
    "substeps": (1, 20),
    "order": (4, 20),
    "runs": (1, 20),
    "held_out": (1, 20),
    "budget": (4, 12),
    "particles": (2, 200),
    "horizon": (1, 20),
    "integrators": (1, 8),
    "neurons": (1, 20),
    "centres": (2, 7),
    "rules": (2, 7),
    "degree": (1, 5),
}


def mutated(draw: random.Random, tables: dict[str, Any]) -> dict[str, Any]:
    """Tables with a few keys changed, added, dropped or misspelt."""
    changed = copy.deepcopy(tables)
    for _ in range(draw.choice((1, 1, 1, 1, 2, 3))):
        name = draw.choice(
            (*tables, *tables, "model", "disturbance", "units", "ensemble", "tune", "compare")
        )
        kind = Scenario.__annotations__.get(name)
        field = next((f for f in msgspec.structs.fields(Scenario) if f.name == name), None)
        if field is None or kind is None:
            continue
        if draw.random() < 0.05:
            changed[name] = anything(draw)
            continue
        table = changed.get(name)
        if not isinstance(table, dict):
            table = changed[name] = {}
        _change(draw, table, _structs(field.type))
    return changed


def _change(draw: random.Random, table: dict[str, Any], kinds: list[type]) -> None:
    """Change one key of a table that one of these structs reads."""
    if not kinds:
        return
    struct = _chosen(draw, table, kinds)
    fields = msgspec.structs.fields(struct)
    act = draw.randrange(20)
    if act == 0 and table:
        table.pop(draw.choice(list(table)))
    elif act == 1 and table:
        key = draw.choice(list(table))
        table[key + "x"] = table.pop(key)
    elif act == 2:
        table[draw.choice((*TEXTS, "entries"))] = anything(draw)
    elif fields:
        field = draw.choice(fields)
        inner = _structs(field.type)
        nested = table.get(field.encode_name)
        if inner and isinstance(nested, dict) and nested and draw.random() < 0.8:
            _change(draw, nested, inner)
            return
        table[field.encode_name] = value(draw, field.encode_name, field.type)


def _chosen(draw: random.Random, table: dict[str, Any], kinds: list[type]) -> type:
    """The struct that reads a table; seldom the table is made that of another one."""
    config = kinds[0].__struct_config__
    if config.tag_field is None:
        return kinds[0]
    if draw.random() < 0.1 or config.tag_field not in table:
        table[config.tag_field] = draw.choice(kinds).__struct_config__.tag
    tag = table.get(config.tag_field)
    return next((kind for kind in kinds if kind.__struct_config__.tag == tag), kinds[0])


def value(draw: random.Random, name: str, kind: Any) -> Any:
    """A value for a key: mostly of its type."""
    if draw.random() < 0.08:
        return anything(draw) if name not in LENGTHS else draw.choice(("x", [], True, -1, 0))
    if name in LENGTHS:
        low, high = LENGTHS[name]
        drawn = draw.uniform(low, high)
        return drawn if isinstance(low, float) else round(drawn)
    return typed(draw, kind)


def typed(draw: random.Random, kind: Any) -> Any:
    """A value of a type."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if kind is float:
        return number(draw)
    if kind is int:
        return draw.choice((0, 1, 2, 3, 5, -1, 40))
    if kind is bool:
        return draw.random() < 0.5
    if kind is str:
        return draw.choice(TEXTS)
    if kind is Array:
        return _array(draw)
    if origin is typing.Literal:
        return draw.choice(parts)
    if origin in (list, tuple):
        count = len(parts) if origin is tuple else draw.randrange(4)
        return [typed(draw, parts[min(i, len(parts) - 1)]) for i in range(count)]
    if origin is dict:
        words = ("k", "sensor.right", "observer.gamma", "plant.A[0,0]", "A[0,0]", "", "a.b[")
        return {draw.choice(words): typed(draw, parts[1])}
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        table: dict[str, Any] = {}
        for field in msgspec.structs.fields(kind):
            if field.required or draw.random() < 0.2:
                table[field.encode_name] = value(draw, field.encode_name, field.type)
        if kind.__struct_config__.tag is not None:
            table[kind.__struct_config__.tag_field] = kind.__struct_config__.tag
        return table
    choices = [part for part in parts if part is not type(None)]
    return typed(draw, draw.choice(choices)) if choices else anything(draw)


def _array(draw: random.Random) -> Any:
    """A number, a list or rows of numbers, now and then ragged."""
    kind = draw.randrange(4)
    if kind < 2:
        return number(draw)
    if kind == 2:
        return [number(draw) for _ in range(draw.choice((1, 2, 2, 3, 0)))]
    columns = draw.choice((1, 2, 3))
    rows = [[number(draw) for _ in range(columns)] for _ in range(draw.choice((1, 2, 3)))]
    if draw.random() < 0.1:
        rows[-1].append(1.0)
    return rows


def _structs(kind: Any) -> list[type]:
    """The structs that a type allows."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [kind]
    every: list[type] = []
    for part in typing.get_args(kind):
        every += _structs(part)
    return every
