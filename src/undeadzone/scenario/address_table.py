"""Tables of a scenario whose keys may be addresses, such as `"sensor.right" = { ... }` directly in [ensemble] or [tune]."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from undeadzone.errors import InputError
from undeadzone.scenario.messages import explain


class Table(NamedTuple):
    """A table's name, what its entries are, and one written out."""

    name: str
    kind: type[msgspec.Struct]
    what: str
    example: str

    def entry_name(self, address: str) -> str:
        """How messages name an entry."""
        return f'{self.name}."{address}"'

    def decoded(self, given: Any) -> Any:
        """The table as TOML gives it, with the keys that are addresses moved to `entries`. Raises InputError."""
        if not isinstance(given, dict) or not isinstance(entries := given.get("entries", {}), dict):
            return given
        for key, value in given.items():
            if isinstance(value, dict) and key != "entries" and "." not in key:
                raise InputError(
                    f"{self.name}.{key}: unknown key; an address stands in quotes: {self.example}"
                )
        entries = entries | {key: value for key, value in given.items() if "." in key}
        rest = {key: value for key, value in given.items() if "." not in key}
        return rest | {
            "entries": {address: self._entry(address, value) for address, value in entries.items()}
        }

    def _entry(self, address: str, value: Any) -> msgspec.Struct:
        if isinstance(value, self.kind):
            return value
        if not isinstance(value, dict):
            raise InputError(
                f"{self.entry_name(address)}: expected {self.what} such as {self.example.partition(' = ')[2]}, found {value!r:.60}"
            )
        try:
            return msgspec.convert(value, self.kind)
        except msgspec.ValidationError as error:
            raise InputError(
                f"{self.entry_name(address)}.{explain(str(error), value, self.kind)}"
            ) from None
