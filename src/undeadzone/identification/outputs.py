"""What a log says of several outputs: one answer each, and one scenario."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

from undeadzone.errors import InputError
from undeadzone.identification.result import Identified
from undeadzone.identification.to_scenario import scenario_text
from undeadzone.support import shown
from undeadzone.support.arrays import finite
from undeadzone.support.files import write_text
from undeadzone.support.shown import Block


@dataclasses.dataclass(frozen=True, eq=False)
class IdentifiedOutputs:
    """The answers of several outputs, each with a plant of its own from all inputs.

    Attributes:
        names: of the outputs.
        outputs: their answers, in this order.
    """

    names: tuple[str, ...]
    outputs: tuple[Identified, ...]

    @property
    def verdict(self) -> str:
        """dead_zone where every output has one, else the first other verdict."""
        words = [one.verdict for one in self.outputs]
        return next((word for word in words if word != "dead_zone"), "dead_zone")

    @property
    def zone(self) -> bool:
        """Whether every output has a dead zone."""
        return all(one.zone for one in self.outputs)

    def scenario(self) -> str:
        """One scenario as TOML text: the outputs' plants side by side, with the same inputs.

        Returns:
            The text.

        Raises:
            InputError: an output has no dead zone, or no plant in continuous time fits.
        """
        for name, one in zip(self.names, self.outputs, strict=True):
            if one.verdict != "dead_zone":
                raise InputError(f"scenario: the verdict on {name} is {one.verdict}")
        return scenario_text([one.answer for one in self.outputs])

    def numbers(self) -> dict[str, Any]:
        """All numbers of the answers, as `--json` prints them."""
        each = {}
        for name, one in zip(self.names, self.outputs, strict=True):
            each[name] = one.numbers()
        return dict(finite({"zone": self.zone, "verdict": self.verdict, "outputs": each}))

    def blocks(self) -> list[Block]:
        """The tables that `undeadzone identify` prints, one for each output."""
        blocks: list[Block] = []
        for name, one in zip(self.names, self.outputs, strict=True):
            blocks += [{"output": name, **one.summary()}]
        return blocks

    __repr__ = shown.in_text
    _repr_html_ = shown.in_notebook

    plot = shown.plot
    """Draw it."""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write all numbers as JSON.

        Args:
            path: the file.

        Returns:
            The path.

        Raises:
            FileError: it cannot be written.
        """
        text = json.dumps(self.numbers(), indent=2, allow_nan=False)
        return write_text(text + "\n", Path(path))
