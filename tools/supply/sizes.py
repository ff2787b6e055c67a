"""What an installation takes: each distribution, what brings it, what it is for."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.metadata import Distribution, packages_distributions
from typing import Final

from benchmarks.markdown import head, row
from packaging.requirements import Requirement

from tools.supply.parts import PROJECT, needed, normal

PURPOSE: Final = {
    "casadi": "graphs of plants, observers and loops, their derivatives and C",
    "clarabel": "semidefinite programs: certificates, gains",
    "click": "the command line",
    "cmaes": "searches without derivatives: `tune`, the arena",
    "lazy-loader": "`import undeadzone` loads what is used",
    "llvmlite": "graphs compiled to machine code: ensembles, live observers",
    "matplotlib": "figures",
    "msgspec": "scenario files read and checked, TOML and JSON",
    "numpy": "arrays",
    "openpyxl": "workbooks of Excel",
    "rich": "bars of progress",
    "scipy": "Riccati equations, optimisers, distributions, `.mat` files",
    "threadpoolctl": "one BLAS thread for `identify` and new observers",
    "tomli-w": "TOML written",
}


def table() -> str:
    """Sizes by direct dependency: its own, and what it alone brings."""
    every = needed()
    sizes = {name: _size(each) for name, each in every.items()}
    direct = sorted(normal(Requirement(text).name) for text in PROJECT["dependencies"])
    rows = []
    for name in sorted(direct, key=sizes.__getitem__, reverse=True):
        others = _without(name)
        alone = sorted(every.keys() - needed(others).keys() - {name})
        more = sum(sizes[each] for each in alone)
        own = "needed by others too" if name in needed(others) else ", ".join(alone)
        cells = (name, PURPOSE[name], f"{sizes[name]:.1f}", f"{more:.1f}", own)
        rows.append(row(*cells))
    without = sum(sizes[name] for name in needed(_without("matplotlib")))
    total = sum(sizes.values())
    words = [f"All {len(every)}: {total:.0f} MB. Without figures (Matplotlib): {without:.0f} MB."]
    least = sorted(imported() & every.keys())
    of_run = sum(sizes[name] for name in least)
    words.append(f"`run --no-figures` imports {', '.join(least)}: {of_run:.0f} MB.")
    title = head("needs", "for", "MB", "brings MB", "which nothing else needs")
    return "\n".join([*title, *rows, "", *words])


def imported() -> set[str]:
    """The distributions that `run` imports without figures, on the file that `init` writes."""
    with tempfile.TemporaryDirectory() as folder:
        _importing(folder, "init", "mine.toml")
        names = _importing(folder, "run", "mine.toml", "--no-figures")
    owners = packages_distributions()
    return {normal(owner) for name in names for owner in owners.get(name, [])}


def _importing(folder: str, *words: str) -> set[str]:
    """The top names of the modules that a command imports, run in a folder."""
    command = [sys.executable, "-X", "importtime", "-m", "undeadzone", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rsplit("|", 1)[1].strip().split(".")[0] for line in lines}


def _without(name: str) -> list[str]:
    """The requirements but for one."""
    return [text for text in PROJECT["dependencies"] if normal(Requirement(text).name) != name]


def _size(owner: Distribution) -> float:
    """What the files of a distribution take [MB], those included that pip compiles."""
    places = [owner.locate_file(file) for file in owner.files or ()]
    sizes = [place.stat().st_size for place in places if place.exists()]  # type: ignore[attr-defined]
    return sum(sizes) / 1e6
