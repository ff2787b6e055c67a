"""A CSV log that comes in live, as bytes, to pieces of samples that a follower takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from undeadzone.logs.clock import Clock, Piece
from undeadzone.logs.samples import LogReader
from undeadzone.results.info import LogInfo
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.follower import Follower, require_units


class LiveLog:
    """A CSV log whose lines come in live: what is wrong with some of them does not end it.

    Args:
        source: the log, for messages.
        scenario: for its step and its units.
        follower: of the same scenario, which takes the samples in.
        chosen: columns that the user names; see `names.parse_columns`.
        strict: whether the first fault is an error.

    Attributes:
        clock: which puts its lines on the steps of the scenario.
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
        self.clock = Clock(scenario.simulation.step, source, strict)
        self._reader = LogReader(source, p, m, chosen, live=True)
        self._source, self._units = source, scenario.units

    def pieces(self, data: bytes, last: bool) -> Iterator[Piece]:
        """The samples in the lines that are whole now, so far as they can be judged.

        Args:
            data: the bytes that came in.
            last: whether no more will come.

        Raises:
            FileError: the log cannot be what the scenario describes, or `strict` is set and a line
                is a fault; after what was good before.
        """
        begun = self._reader.layout is not None
        samples = self._reader.feed(data, last)
        layout = self._reader.layout
        if layout is None:
            return
        if not begun:
            require_units(layout, self._units, self._source)
        for piece in self.clock.place(samples, self._reader.latest, layout.timed, last):
            if piece.samples.t.size:
                yield piece

    def info(self, follower: Follower) -> LogInfo:
        """What the log comes to. Raises FileError."""
        return follower.info(self._source, self._reader.layout, self.clock, self.clock.faults)
