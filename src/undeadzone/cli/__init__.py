"""Command line: a file per command. A command imports its needs when it runs."""

from __future__ import annotations

import atexit
import ctypes
import functools
import gc
import itertools
import os
import sys
from contextlib import suppress
from difflib import get_close_matches

import click

import undeadzone
from undeadzone.cli.arm import arm
from undeadzone.cli.common import print_line
from undeadzone.cli.ending import (
    end_at_once_on_signals,
    ignore_signals,
    report_failure,
    run_to_exit_code,
)
from undeadzone.cli.estimate import estimate
from undeadzone.cli.init import init
from undeadzone.cli.run import run
from undeadzone.cli.watch import watch
from undeadzone.errors import InputError
from undeadzone.util.installed import advise_on_arena, list_registered_places, load_object

# In the order in which they are met.
BLOCKS = {
    "Start": ("init", "run", "identify", "export"),
    "Go on": ("check", "design", "estimate", "ensemble"),
    "Special": ("fit", "tune", "watch", "arm"),
}
OF_MOST = ("out", "as_json", "no_figures", "untrusted")  # options
# of malloc.h
M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
# bytes that stay with a process; from which an array has its own pages
RETAINED = 2**29
MAPPED = 2**25
OTHER_NAMES = {"simulate": "run", "sim": "run", "plot": "run", "compare": "arena", "new": "init"}


class Commands(click.Group):
    """Group of commands that suggests a name for a misspelt command."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the name of the command, the command and its arguments.

        Raises UsageError.
        """
        name = args[0]
        if name == "help":
            args = [*(args[1:] or [""]), "--help"]
            if not args[0]:
                click.echo(ctx.get_help())
                ctx.exit()
            name = args[0]
        if name.endswith(".toml"):
            ctx.fail(f"{name!r} is not a command. To run this scenario: undeadzone run {name}")
        if self.get_command(ctx, name) is None and not name.startswith("-"):
            near = get_close_matches(name, self.list_commands(ctx), 1)
            meant = OTHER_NAMES.get(name, "".join(near))
            advice = f". Did you mean {meant!r}?" if meant else "."
            if "arena" in (name, meant):
                advice = advise_on_arena() or advice
            ctx.fail(f"No such command {name!r}{advice}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        """Return the exit code of a command: 1 for a negative answer, False.

        A broken pipe is reported here, as click has its own exit code.
        """
        try:
            answer = super().invoke(ctx)
            return int(not answer) if isinstance(answer, bool) else answer
        except BrokenPipeError as error:
            return report_failure(error)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands, those that `BLOCKS` does not name last."""
        names = {*super().list_commands(ctx), *_list_registered_commands()}
        named = names.intersection(itertools.chain(*BLOCKS.values()))
        return [*sorted(named), *sorted(names - named)]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Return a command by its name, or None for an unknown name."""
        own = super().get_command(ctx, name)
        if own is not None:
            return own
        place = _list_registered_commands().get(name)
        return None if place is None else _load_command(name, place)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in the order of their use, each with its arguments."""
        known = [name for name in self.list_commands(ctx) if self._is_usable(ctx, name)]
        others = set(known).difference(*BLOCKS.values())
        blocks = BLOCKS | {"Special": (*BLOCKS["Special"], *sorted(others))}
        for title, names in blocks.items():
            self._format_block(ctx, formatter, title, [name for name in names if name in known])
        with formatter.section("Options of most commands"):
            options = [each for each in run.params if each.name in OF_MOST]
            formatter.write_dl([each.get_help_record(ctx) or ("", "") for each in options])

    def get_first_help(self, ctx: click.Context) -> str:
        """Return the help of a first call: four commands, and the names of the others."""
        formatter = ctx.make_formatter()
        self.format_usage(ctx, formatter)
        self.format_help_text(ctx, formatter)
        first = BLOCKS["Start"]
        self._format_block(ctx, formatter, "Start", [n for n in first if self._is_usable(ctx, n)])
        others = [name for name in self.list_commands(ctx) if name not in first]
        with formatter.section("More, by undeadzone --help"):
            formatter.write_text(", ".join(others))
        return formatter.getvalue().rstrip("\n")

    def _format_block(
        self, ctx: click.Context, formatter: click.HelpFormatter, title: str, names: list[str]
    ) -> None:
        """Write some commands below a title."""
        with formatter.section(title):
            formatter.write_dl([self._command_usage(ctx, name) for name in names])

    def _is_usable(self, ctx: click.Context, name: str) -> bool:
        """Return whether a command can be imported. If not, print why on stderr."""
        try:
            return self.get_command(ctx, name) is not None
        except InputError as error:
            print_line(f"undeadzone: {error}. It is left out", err=True)
            return False

    def _command_usage(self, ctx: click.Context, name: str) -> tuple[str, str]:
        """Return the command line of a command that is usable, and its summary."""
        command = self.get_command(ctx, name)
        assert command is not None
        arguments = [each for each in command.params if isinstance(each, click.Argument)]
        typed = [name, *(each.make_metavar(ctx) for each in arguments)]
        return " ".join(typed), command.get_short_help_str(100)


def _load_command(name: str, place: str) -> click.Command:
    """Return the command that an installed package registers. Raises InputError."""
    command = load_object(f"command {name!r}", place)
    if not isinstance(command, click.Command):
        raise InputError(f"command {name!r} is registered at {place}, which is not a click command")
    return command


@functools.cache
def _list_registered_commands() -> dict[str, str]:
    """Return where commands are that installed packages register, by name.

    `--help` needs each of them. The installed packages are read once, as a process is one command.
    """
    return list_registered_places("undeadzone.commands")


@click.group(
    cls=Commands,
    invoke_without_command=True,
    epilog="Exit codes: 0 done. 1 finished, and the answer is negative (diverged, not certified, "
    "not identifiable). 2 bad input. 70 an error of undeadzone itself. 130 Ctrl-C. 143 terminated.",
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
        "show_default": True,
    },
)
@click.version_option(undeadzone.__version__, "-V", "--version", prog_name="undeadzone")
@click.pass_context
def group(ctx: click.Context) -> None:
    """Estimate the true output and the width that a dead zone or backlash hides."""
    if ctx.invoked_subcommand is None:
        assert isinstance(ctx.command, Commands)
        click.echo(ctx.command.get_first_help(ctx))


COMMANDS = (run, init, estimate, watch, arm)
for command in COMMANDS:
    group.add_command(command)


def _retain_freed_memory() -> None:
    """Keep freed memory for later allocations.

    A fifth of the time of `identify` on 13,000 samples went into pages that were given back and
    cleared again (glibc, elsewhere nothing is done).
    """
    with suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_TRIM_THRESHOLD, RETAINED)
        mallopt(M_MMAP_THRESHOLD, MAPPED)


def main() -> None:
    """Run a command. An error becomes one line on stderr and an exit code.

    Entry point of the tool.
    """
    atexit.register(ignore_signals)  # the first to come is the last to be called
    # A command lives for a second and multiplies small matrices: BLAS threads and frequent garbage
    # collection only delay it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(100_000)
    _retain_freed_memory()
    code = run_to_exit_code(lambda: group.main(standalone_mode=False))
    end_at_once_on_signals()
    sys.exit(code)
