"""The paper's letters: scenario keys and C fields that are named exist."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from documents import EXAMPLES
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.plants.options import Plant
from undeadzone.registry import CONTROLLERS, OBSERVERS, Registry
from undeadzone.scenario.reader import read
from undeadzone.signals.exosystem import Sine
from undeadzone_export import export
from undeadzone_paper.equations import read_letters

FIRMWARE = EXAMPLES / "firmware.toml"
REQUESTED = (
    "x in (1)-(12)", "x in (14)", "y", "y^", "y~", "d^", "m", "k_s", "sigma", "alpha", "P, Q", "L",
    "d_M", "k_p, k_d", "beta^", "chi_r, chi_l, chi_bar",
)  # fmt: skip


def _keys_of_methods(registry: Registry) -> set[str]:
    return {field for options in registry.list_options() for field in options.__struct_fields__} | {
        "method"
    }


def test_the_letters_of_the_paper_are_all_there() -> None:
    letters = read_letters()
    assert {letter.paper for letter in letters} >= set(REQUESTED)
    assert len({letter.paper for letter in letters}) == len(letters)
    assert [letter.paper for letter in letters if not letter.ours] == ["beta^"]


def test_every_key_is_one_of_a_scenario() -> None:
    known = {
        "observer": _keys_of_methods(OBSERVERS),
        "controller": _keys_of_methods(CONTROLLERS),
        "sensor": {field.name for field in msgspec.structs.fields(Sensor)},
        "plant": {field.name for field in msgspec.structs.fields(Plant)},
        "reference": {field.name for field in msgspec.structs.fields(Sine)},
    }
    keys = [key for letter in read_letters() for key in letter.key.split(", ") if key]
    assert len(keys) > 15
    for key in keys:
        table, _, name = key.partition(".")
        assert name in known[table], key


def test_every_field_is_one_of_exported_code(tmp_path: Path) -> None:
    export(read(FIRMWARE), out=tmp_path)
    (header,) = tmp_path.glob("*.h")
    structs = re.findall(r"typedef struct\n\{(.*?)\} \w+_(in|out);", header.read_text(), re.DOTALL)
    fields = {f"{name}.{field}" for body, name in structs for field in re.findall(r"(\w+)\[", body)}
    named = [field for letter in read_letters() for field in letter.c.split(", ") if field]
    assert len(named) > 8
    assert set(named) <= fields
