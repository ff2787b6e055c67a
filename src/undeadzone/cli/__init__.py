"""The command line: thin, one file per command; a command imports what it needs when it runs."""

from __future__ import annotations

import gc
import os
import sys
from typing import TYPE_CHECKING

import click

import undeadzone
from undeadzone.cli.arm import arm
from undeadzone.cli.check import check
from undeadzone.cli.design import design
from undeadzone.cli.ending import ended
from undeadzone.cli.ensemble import ensemble
from undeadzone.cli.estimate import estimate
from undeadzone.cli.export import export
from undeadzone.cli.identify import identify
from undeadzone.cli.init import init
from undeadzone.cli.run import run
from undeadzone.cli.tune import tune
from undeadzone.cli.watch import watch

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

OTHER_NAMES = {"simulate": "run", "sim": "run", "plot": "run", "compare": "arena", "new": "init"}


class Commands(click.Group):
    """The commands, which say what may be meant by a name that is none of them."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command, and its arguments. Raises UsageError."""
        name = args[0]
        if name in OTHER_NAMES:
            ctx.fail(f"No such command {name!r}. Did you mean {OTHER_NAMES[name]!r}?")
        if name.endswith(".toml"):
            ctx.fail(f"{name!r} is no command; to run this scenario: undeadzone run {name}")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of all commands, those of other packages last."""
        return [*super().list_commands(ctx), *_registered()]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """A command by its name; None where there is none."""
        own = super().get_command(ctx, name)
        if own is not None:
            return own
        point = _registered().get(name)
        return None if point is None else point.load()

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Those that other packages register: the tool's own stand above, each with an example."""
        lines = []
        for name in _registered():
            command = self.get_command(ctx, name)
            lines.append((name, command.get_short_help_str(80) if command else ""))
        if lines:
            with formatter.section("From other packages"):
                formatter.write_dl(lines)


def _registered() -> dict[str, EntryPoint]:
    """The commands that installed packages register under `undeadzone.commands`, by name."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group="undeadzone.commands")}


@click.group(
    cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(undeadzone.__version__, "-V", "--version", prog_name="undeadzone")
def group() -> None:
    """See through a sensor's dead zone.

    \b
    undeadzone init mine.toml               write a commented scenario to start from
    undeadzone run mine.toml                simulate your plant, sensor, observer and controller
    undeadzone check mine.toml              assess the gains: proof, rate, what can be known
    undeadzone design mine.toml             find gains with a proof: rate against noise
    undeadzone ensemble mine.toml           run it thousands of times with what may vary
    undeadzone tune mine.toml               find the gains that do best over such runs
    undeadzone identify log.csv             find plant and dead zone from a log of a real plant
    undeadzone estimate mine.toml log.csv   let its observer follow a recorded log
    undeadzone watch mine.toml              estimate from samples as they come on stdin
    undeadzone arm robot.urdf               show the arm in a URDF file, and write a scenario for it
    undeadzone export mine.toml             write the observer as C for a microcontroller

    Exit codes: 0 done; 1 it ran, and the answer is no (diverged, not certified, not identifiable);
    2 bad input; 70 a mistake of undeadzone itself; 130 Ctrl-C; 143 terminated.
    """


COMMANDS = (
    run,
    ensemble,
    tune,
    check,
    design,
    init,
    identify,
    estimate,
    watch,
    arm,
    export,
)
for command in COMMANDS:
    group.add_command(command)


def main() -> None:
    """Entry point: run a command, turn errors into one line on stderr and an exit code."""
    # A command lives for a second and multiplies small matrices: BLAS threads and frequent garbage
    # collection only delay it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(100_000)
    sys.exit(ended(lambda: group.main(standalone_mode=False)))
