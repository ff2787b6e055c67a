"""What `watch` and `estimate` share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from undeadzone.cli.common import Command

if TYPE_CHECKING:
    from undeadzone.results.info import LogInfo


def strict_option(command: Command) -> Command:
    """Add --strict."""
    return click.option(
        "--strict", is_flag=True, help="Stop at the first line that cannot be read."
    )(command)


def columns_option(command: Command) -> Command:
    """Add --columns."""
    return click.option(
        "--columns",
        default=None,
        metavar="y=NAME,u=NAME",
        help="Columns by name or number: t=1,y=angle,u=voltage; several: y[0]=a,y[1]=b.",
    )(command)


def exit_code(info: LogInfo) -> int:
    """1 where the record is not consistent, else 0."""
    return 1 if info.consistent is False else 0
