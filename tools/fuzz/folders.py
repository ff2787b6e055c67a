"""Folders of strangers: modules, links, pipes, settings and names that do something elsewhere.

A command runs inside of one. Nothing may be written but below --out, and no module may run.
"""

from __future__ import annotations

import functools
import hashlib
import os
import random
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Final

from tests.traps import SHORT, TRAP, TRAPS

from tools.fuzz.case import Case, End
from tools.fuzz.damage import TEXTS
from tools.fuzz.identify_logs import sound
from tools.fuzz.urdfs import SMALL

STRANGE, HOME, OUT = "strange", "home", "results"
SECRET: Final = "hunter2-of-home"
MODULES: Final = (
    *TRAPS,
    *("ctypes", "json", "matplotlib", "llvmlite", "site", "usercustomize", "conftest", "click"),
    *("casadi", "rich", "tomllib", "tempfile", "ssl", "distributed", "IPython", "scipy", "adam"),
)
SETTINGS: Final = {
    "matplotlibrc": "text.usetex: True\nbackend: nosuch\n",
    "pyvenv.cfg": "home = .\n",
    "x.pth": "import os; open('RAN', 'w').close()\n",
    "pyproject.toml": "[tool.undeadzone]\nx = 1\n",
    ".undeadzone": "x",
    "libcasadi.so": "x",
    "gcc": "#!/bin/sh\ntouch RAN\n",
    "cc": "#!/bin/sh\ntouch RAN\n",
}
HOSTILE: Final = (
    "$(touch RAN)",
    "`touch RAN`; touch RAN",
    "<script>alert(1)</script>",
    "</title><img src=x onerror=1>",
    '*/ int x; #include "/etc/passwd" /*',
    "'''\nimport os\n'''",
    '"; import os; os.system("touch RAN") #',
    "{title}",
    "=cmd|' /C calc'!A0",
    "../../home/x",
    "\\input{/etc/passwd} $\\alpha$",
    "a\tb\nc\rd",
    "\u202e\u0000\x07",
    "?" + "?/" * 3,
)
TITLES: Final = [text for text in TEXTS if text != "nan"]  # it would stand among the numbers
PATHS: Final = (
    *("linked.csv", "hard.csv", "pipe.csv", "folder.csv", "loop.csv", "missing.csv", "a\0b"),
    *("../home/secret.csv", "/etc/passwd", "/dev/zero", "/proc/self/environ", "x" * 5000, "."),
)
NAMES: Final = (
    *("s.toml", "s.toml", "-rf.toml", "a\nb.toml", "\x1b[2J.toml", "$(touch RAN).toml", "ö.toml"),
    *("a b.toml", "'\".toml", ".toml", "%s.toml", "x" * 240 + ".toml", "s.toml.toml", "con.toml"),
)
COMMANDS: Final = (
    ("run", "--no-figures"),
    ("run",),
    ("run", "--no-figures", "--csv", "--json"),
    ("check", "--no-figures"),
    ("export", "--to", "c"),
    ("export", "--to", "arduino"),
    ("export", "--to", "python"),
    ("export", "--to", "page"),
    ("ensemble", "--no-figures", "--runs", "3"),
    ("watch",),
    ("estimate", "--no-figures"),
    ("identify", "--no-figures", "--order", "1"),
    ("arm",),
)
WEIGHTS: Final = (4, 1, 2, 2, 2, 1, 1, 1, 1, 2, 2, 1, 1)
# What strangers put where results go, if they own that folder too.
RESULTS: Final = (
    *("run.npz", "run.csv", "check.json", "runs.npz", "runs.npz.partial", "report.html"),
    *(
        "manifest.json",
        "estimate.npz",
        "identify.json.partial",
        "live.html",
        "state.npz",
        "arm.toml",
    ),
)


def case(draw: random.Random) -> Case:
    """A folder, and a command in it."""
    name, title = draw.choice(NAMES), draw.choice((*HOSTILE, *TITLES))
    log = draw.choice(("log.csv", "log.csv", "-log.csv", "$(touch RAN).csv", "b\n.csv"))
    files = {name: _scenario(draw, title), log: _log(draw), "arm.urdf": _robot(draw)}
    for module in draw.sample(MODULES, draw.choice((0, 3, len(MODULES)))):
        files[f"{module}{draw.choice(('.py', '.py', '/__init__.py'))}"] = TRAP
    for setting in draw.sample(sorted(SETTINGS), draw.choice((0, 2, 5))):
        files[setting] = SETTINGS[setting]
    command, *options = draw.choices(COMMANDS, WEIGHTS)[0]
    out = f"../{OUT}"
    first = {"identify": [f"./{log}"], "arm": ["arm.urdf"]}.get(command, [f"./{name}"])
    words = [command, *first, *([f"./{log}"] if command == "estimate" else []), *options]
    if command == "watch":
        words += ["--state", f"{out}/state.npz"]
    else:
        words += ["--out", f"{out}/live.html" if "page" in options else out]
    if command != "arm":
        words += draw.choice((["--untrusted", "."], ["--untrusted", "."], []))
    planted = draw.choice(((), (), draw.sample(RESULTS, 3)))
    apart = "started" if draw.random() < 0.1 else "forked"
    before: dict[str, tuple[object, ...]] = {}
    return Case(
        f"{command}{', untrusted' if '--untrusted' in words else ''}",
        {f"{STRANGE}/{path}": text.encode("utf-8", "replace") for path, text in files.items()}
        | {f"{HOME}/secret.csv": f"t,r\n0.0,1.0\n1.0,2.0\n# {SECRET}\n".encode()},
        words,
        stdin=files[log].encode("utf-8", "replace") if command == "watch" else b"",
        made=functools.partial(_made, _trap_of(draw), planted, before),
        inside=STRANGE,
        apart=apart,
        judged=functools.partial(_left, before, apart == "started"),
    )


def _scenario(draw: random.Random, title: str) -> str:
    """The scenario, with words and paths of the stranger's choice."""
    lines = SHORT.splitlines()
    lines[0] = f"title = {_quoted(title)}"
    if draw.random() < 0.4:
        path = _quoted(draw.choice(PATHS))
        lines = [line for line in lines if not line.startswith("reference")]
        lines.append(f'reference = {{ kind = "csv", path = {path} }}')
    if draw.random() < 0.4:
        words = ", ".join(
            f"{key} = {_quoted(draw.choice(HOSTILE))}"
            for key in ("output", "input", "time")[: draw.randrange(1, 3)]
        )
        lines.append(f"units = {{ {words} }}")
    return "\n".join(lines)


def _quoted(text: str) -> str:
    """A string of TOML."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return (
        '"'
        + "".join(mark if mark.isprintable() else f"\\u{ord(mark):04x}" for mark in escaped)
        + '"'
    )


def _log(draw: random.Random) -> str:
    """A log, whose columns may have names that do something."""
    words = ["t", "y", "u"]
    if draw.random() < 0.5:
        words[draw.randrange(3)] += draw.choice(
            (f" [{draw.choice(HOSTILE)}]", draw.choice(HOSTILE))
        )
    if draw.random() < 0.3:
        words.append(draw.choice(HOSTILE))
    rows = [",".join(map(repr, [*row, *[0.0] * (len(words) - 3)])) for row in sound(draw, 110)]
    return "\n".join([",".join(words), *rows]) + "\n"


def _robot(draw: random.Random) -> str:
    """An arm, whose parts may have names that do something."""
    text = SMALL.decode()
    word = draw.choice(HOSTILE).translate({ord(mark): None for mark in '<&\0\x07"'})
    return text.replace('"b"', f'"{word}"') if draw.random() < 0.5 else text


def _trap_of(draw: random.Random) -> str:
    """What the links of the folder lead to."""
    return draw.choice((f"../{HOME}/secret.csv", f"../{HOME}/new", f"../{HOME}", "/dev/zero"))


def _made(
    target: str, planted: tuple[str, ...], before: dict[str, tuple[object, ...]], folder: Path
) -> None:
    """Put links and pipes into the folder, and some where results go; remember what is there."""
    strange, secret = folder / STRANGE, folder / HOME / "secret.csv"
    (strange / "linked.csv").symlink_to(target)
    (strange / "loop.csv").symlink_to("loop.csv")
    os.link(secret, strange / "hard.csv")
    os.mkfifo(strange / "pipe.csv")
    (strange / "folder.csv").mkdir()
    if planted:
        (folder / OUT).mkdir()
    acts: tuple[Callable[[Path], None], ...] = (
        lambda path: path.symlink_to(target),
        lambda path: os.link(secret, path),
        lambda path: os.mkfifo(path),
    )
    for number, name in enumerate(planted):
        acts[number % len(acts)](folder / OUT / name)
    before.update(seen(folder))


def seen(folder: Path, links: bool = False) -> dict[str, tuple[object, ...]]:
    """Everything outside of --out: its kind, mode, content, time, and if asked for its links."""
    found: dict[str, tuple[object, ...]] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name.split("/")[0] == OUT:
            continue
        state: os.stat_result = path.lstat()
        plain = stat.S_ISREG(state.st_mode)
        content = hashlib.sha256(path.read_bytes()).hexdigest() if plain else ""
        found[name] = (state.st_mode, content, plain * state.st_mtime_ns, links * state.st_nlink)
    return found


def _left(before: dict[str, tuple[object, ...]], started: bool, folder: Path, end: End) -> str:
    """What was written elsewhere, or run."""
    after = seen(folder)
    ran = [name for name in folder.rglob("*") if name.name == "RAN"]
    if ran:
        return f"it ran: {ran[0]}"
    changed = [name for name in before | after if before.get(name) != after.get(name)]
    if changed:
        return f"written outside of --out: {changed[:3]!a}"
    if SECRET in end.out + end.err:
        return "it tells what stands in files elsewhere"
    scratch = any(path.name.startswith(".scratch") for path in folder.rglob("*"))
    if started and scratch:  # it is deleted as the interpreter ends
        return "scratch is left"
    return ""
