"""Run the benchmarks named on the command line and print their tables.

With --write their tables replace those of the same title in benchmarks/RESULTS.md, where each has
the commit of the code that made it. Without names all are run and written, one after the other.
The arguments of a table are options behind its name: `python -m benchmarks NAME --count 10`.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import itertools
import os
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.markdown import parted
from benchmarks.results import commit

HERE = Path(__file__).parent
OWN = {"UNDEADZONE_CACHE"}  # variables that benches set themselves
HEAD = """# Results

Written by `make bench`, or table by table by `python -m benchmarks --write NAME`. Times are ratios
within one run; machines differ, ratios less so.
"""


def find_benches() -> dict[str, Path]:
    """Find the files that have a table, by name."""
    found: dict[str, Path] = {}
    for path in sorted(HERE.rglob("*.py")):
        if "\ndef table(" in path.read_text(encoding="utf-8"):
            if path.stem in found:
                raise ValueError(f"two benches have the name {path.stem}")
            found[path.stem] = path
    return found


def make_table(path: Path, options: Sequence[str] = ()) -> str:
    """Run a bench."""
    module = ".".join(["benchmarks", *path.relative_to(HERE).with_suffix("").parts])
    table: Callable[..., str] = importlib.import_module(module).table
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {path.stem}")
    for name, argument in inspect.signature(table).parameters.items():
        default = argument.default
        several = isinstance(default, list | tuple)
        kind = Path if default is None else type(default[0] if several else default)
        parser.add_argument(f"--{name}", type=kind, default=default, nargs="+" if several else None)
    return table(**vars(parser.parse_args(options)))


def write_command(name: str, path: Path, options: Sequence[str] = ()) -> str:
    """Write the command that makes a table, with the variables of the environment that it reads."""
    text = path.read_text(encoding="utf-8")
    read = {*re.findall(r'environ(?:\.get\(|\[)f?"([A-Z_]+)', text)} - OWN
    used = sorted(word for word in os.environ if word.startswith(tuple(read)))
    settings = [f"{word}={os.environ[word]}" for word in used]
    return " ".join([*settings, "python -m benchmarks", name, *map(shlex.quote, options)])


def main() -> int:
    # idle threads of one program must not spin beside the next one's
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    words = [word for word in sys.argv[1:] if word != "--write"]
    names = list(itertools.takewhile(lambda word: not word.startswith("--"), words))
    options, writes = words[len(names) :], "--write" in sys.argv or not words
    results, benches = HERE / "RESULTS.md", find_benches()
    unknown = [name for name in names if name not in benches]
    if unknown:
        print(f"no bench {', '.join(unknown)}; benches: {', '.join(benches)}", file=sys.stderr)
        return 2
    for name in names or benches:
        print(f"{name} ...", file=sys.stderr, flush=True)
        origin = f"At commit {commit()} (`{write_command(name, benches[name], options)}`).\n"
        table = make_table(benches[name], options)
        tables = {title: f"{text.strip()}\n\n{origin}" for title, text in parted(table).items()}
        print("\n".join(tables.values()), flush=True)
        if writes:
            stored = parted(results.read_text(encoding="utf-8"))
            every = [f"{text.strip()}\n" for text in (stored | tables).values()]
            results.write_text("\n".join([HEAD, *every]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
