"""Tables of a scenario whose keys may be addresses.

An example is `"sensor.right" = { ... }` directly in [ensemble] or [tune].
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from undeadzone.errors import InputError
from undeadzone.scenario.messages import explain


class Table(NamedTuple):
    """A table of a scenario, some of whose keys are addresses.

    Attributes:
        name: name of the table.
        kind: struct of an entry.
        what: an entry in words, such as "a distribution".
        example: an entry written out.
    """

    name: str
    kind: type[msgspec.Struct]
    what: str
    example: str

    def entry_name(self, address: str) -> str:
        """Return the name of an entry for messages."""
        return f'{self.name}."{address}"'

    def decode_table(self, table: Any) -> Any:
        """Return the table as TOML gives it, with the keys that are addresses moved to `entries`.

        Anything but a table is handed back as it is.

        Raises:
            InputError: a key is not known and not an address, or an entry cannot be read.
        """
        if not isinstance(table, dict):
            return table
        entries = table.get("entries", {})
        if not isinstance(entries, dict):
            return table
        for key, value in table.items():
            if isinstance(value, dict) and key != "entries" and "." not in key:
                raise InputError(
                    f"{self.name}.{key}: unknown key. An address stands in quotes: {self.example}"
                )
        entries = entries | {key: value for key, value in table.items() if "." in key}
        options = {key: value for key, value in table.items() if "." not in key}
        options["entries"] = {
            address: self._entry(address, value) for address, value in entries.items()
        }
        return options

    def _entry(self, address: str, value: Any) -> msgspec.Struct:
        """Return an entry as TOML gives it, read. Raises InputError."""
        if isinstance(value, self.kind):
            return value
        if not isinstance(value, dict):
            example = self.example.partition(" = ")[2]
            raise InputError(
                f"{self.entry_name(address)}: expected {self.what} such as {example}, "
                f"found {value!r:.60}"
            )
        try:
            return msgspec.convert(value, self.kind)
        except msgspec.ValidationError as error:
            reason = explain(str(error), value, self.kind)
            raise InputError(f"{self.entry_name(address)}.{reason}") from None
