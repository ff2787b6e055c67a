"""A CSV log as bytes, from wherever they come, to samples that a follower takes."""

from __future__ import annotations

from collections.abc import Mapping

from undeadzone.logs.grid import Grid, Regular
from undeadzone.logs.samples import LogReader
from undeadzone.results.info import LogInfo
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.follower import Follower, require_units


class TextLog:
    """A CSV log on the steps of a scenario.

    Args:
        source: the log, for messages.
        scenario: for its step and its units.
        follower: of the same scenario.
        chosen: columns that the user names; see `names.parse_columns`.
        strict: whether a line that cannot be read is an error.
    """

    def __init__(
        self,
        source: str,
        scenario: Scenario,
        follower: Follower,
        chosen: Mapping[str, str],
        strict: bool,
    ) -> None:
        p, m = follower.model.p, follower.model.m
        self.reader = LogReader(source, p, m, chosen, strict)
        self.grid = Grid(scenario.simulation.step, source)
        self._source, self._units = source, scenario.units
        self._checked = False

    def feed(self, data: bytes, last: bool) -> Regular:
        """The samples in the lines that are whole now, one step apart.

        Args:
            data: the bytes that came in.
            last: whether no more will come.

        Raises:
            FileError: the log cannot be what the scenario describes.
        """
        samples = self.reader.feed(data, last)
        layout = self.reader.layout
        if layout is not None and not self._checked:
            require_units(layout, self._units, self._source)
            self._checked = True
        timed = layout is not None and layout.time is not None and layout.seconds is not None
        return self.grid.place(samples, timed)

    def info(self, follower: Follower) -> LogInfo:
        """What the log comes to. Raises FileError."""
        reader = self.reader
        return follower.info(self._source, reader.layout, self.grid, reader.unreadable, reader.why)
