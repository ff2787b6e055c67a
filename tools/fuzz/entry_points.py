"""Packages that register something: missing, broken, wrong, with strange names; or all right.

What is broken is named and left out; everything else works as if it was not there.
"""

from __future__ import annotations

import functools
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.traps import SHORT

from tools.fuzz.case import Case, End
from tools.fuzz.damage import TEXTS

SITE: Final = "site"
GROUPS: Final = ("commands", "observers", "controllers", "compensators", "names", "nonsense")
MODULES: Final = {
    "right_mod": "import click\nimport msgspec\n\n"
    "@click.command()\ndef cmd():\n    print('hello')\n\n"
    "class Opt(msgspec.Struct):\n    pass\n",
    "raises_mod": "raise RuntimeError('no\\nway\\x1b[2J')\n",
    "exits_mod": "raise SystemExit(3)\n",
    "syntax_mod": "def broken(:\n",
    "prints_mod": "class K: pass\ncmd = 3\n",
    "import_mod": "import nosuch_package\n",
    "memory_mod": "raise MemoryError\n",
    "deep_mod": "def f(): return f()\nf()\n",
    "warns_mod": "import warnings\nwarnings.warn('old')\nclass K: pass\n",
    "lazy_mod": "def __getattr__(name):\n    raise ValueError(name)\n",
}
PLACES: Final = (
    *(f"{module}:{what}" for module in MODULES for what in ("cmd", "K", "Opt")),
    *(
        "nosuch:cmd",
        "nosuch",
        "right_mod",
        ":x",
        "a.b.c:d.e",
        "right_mod:cmd.x",
        "right_mod:nosuch",
    ),
    *("os:system", "json:loads", "math:pi", "undeadzone:run", "x:y [extra]", "", "ä:ö", "0:0"),
)
NAMES: Final = (
    *(
        "mine",
        "mine",
        "run",
        "check",
        "kalman",
        "identify",
        "Sensor",
        "read",
        "help",
        "-x",
        "--help",
    ),
    *("a b", "ä", "x" * 300, "__init__", "mine.toml", "\x1b[2J", "{0}", "%s"),
)
COMMANDS: Final = (
    ["--help"],
    ["--help"],
    ["mine"],
    ["mine", "--help"],
    ["run", "s.toml", "--no-figures"],
    ["check", "m.toml", "--no-figures"],
    ["run", "--help"],
    ["identify", "--help"],
    ["nosuch"],
    ["--version"],
)
SILENT: Final = (["run", "--help"], ["--version"], ["run", "s.toml", "--no-figures"])


def case(draw: random.Random) -> Case:
    """Two packages or so, and a command beside them."""
    files = {f"{SITE}/{name}.py": text for name, text in MODULES.items()}
    for number in range(draw.choice((1, 1, 2, 4))):
        folder = f"{SITE}/e{number}-1.dist-info"
        files[f"{folder}/METADATA"] = f"Metadata-Version: 2.1\nName: e{number}\nVersion: 1\n"
        files[f"{folder}/entry_points.txt"] = _entry_points(draw)
    files["s.toml"] = SHORT
    files["m.toml"] = SHORT.replace('"kalman"', f'"{draw.choice(("mine", "kalman"))}"')
    command = draw.choice(COMMANDS)
    return Case(
        " ".join(command[:2]),
        {name: text.encode("utf-8", "replace") for name, text in files.items()},
        command,
        apart="started",
        settings={"PYTHONPATH": SITE},
        judged=functools.partial(_left, command),
    )


def _entry_points(draw: random.Random) -> str:
    """A file of entry points, now and then damaged."""
    lines = []
    for group in draw.sample(GROUPS, draw.choice((1, 2, 3))):
        lines.append(f"[undeadzone.{group}]")
        for _ in range(draw.choice((1, 1, 2, 5))):
            lines.append(f"{draw.choice(NAMES)} = {draw.choice(PLACES)}")
    if draw.random() < 0.1:
        lines.insert(draw.randrange(len(lines) + 1), draw.choice((*TEXTS, "[", "=", "x")))
    return "\n".join(lines) + "\n"


def _left(command: Sequence[str], folder: Path, end: End) -> str:
    """What is wrong with the end of a command beside broken packages; empty: nothing."""
    if command in (["--help"], *SILENT) and end.code not in (0, 1):
        return f"a package that is not asked for ends {command[0]} with {end.code}"
    return ""
