"""What can be known of an output, in words."""

from __future__ import annotations

from collections.abc import Mapping

from undeadzone.analysis.identifiability.linear import DIRECTIONS


def yes_no(verdict: Mapping[str, bool]) -> str:
    """What can be known of one output: right yes, left NO, ..."""
    words = {True: "yes", False: "NO"}
    return ", ".join(f"{name} {words[bool(verdict[name])]}" for name in DIRECTIONS)
