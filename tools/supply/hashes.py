"""Hashes of the files that pip installs, for those who want no other bytes.

pip takes hashes from a file of requirements only: in a file of constraints they refuse every
requirement that has none itself. constraints.txt stays what `make` uses.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from tools.supply.parts import ROOT, needed, normal, pinned

HEAD: Final = (
    "# Made by `python -m tools.supply hashes`: files for CPython {python} on {machine}.\n"
    "# pip install --require-hashes -r {name}\n"
)
RUNTIME: Final = ROOT / "requirements-hashed.txt"  # what undeadzone brings without extras
EVERYTHING: Final = ROOT / "constraints-hashed.txt"  # what constraints.txt names


def write() -> list[Path]:
    """Write both files of hashes."""
    versions = pinned()
    found = _asked(versions)
    for path, names in ((RUNTIME, set(needed())), (EVERYTHING, set(versions))):
        machine = f"{sys.platform} {platform.machine()}"
        python = ".".join(map(str, sys.version_info[:2]))
        lines = [
            f"{name}=={versions[name]} --hash=sha256:{found[name]}\n" for name in sorted(names)
        ]
        head = HEAD.format(python=python, machine=machine, name=path.name)
        path.write_text(head + "".join(lines), encoding="utf-8")
    return [RUNTIME, EVERYTHING]


def read(path: Path) -> dict[str, tuple[str, list[str]]]:
    """The version and the hashes of each name in a file of hashes."""
    entries = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            pin, *hashes = line.split(" --hash=sha256:")
            name, version = pin.split("==")
            entries[name] = version, hashes
    return entries


def _asked(versions: dict[str, str]) -> dict[str, str]:
    """The sha256 of the file of each version that pip would install here; nothing is installed."""
    with tempfile.TemporaryDirectory() as folder:
        wanted, report = Path(folder) / "wanted.txt", Path(folder) / "report.json"
        wanted.write_text("".join(f"{name}=={version}\n" for name, version in versions.items()))
        asked = ["install", "--quiet", "--dry-run", "--ignore-installed", "--no-deps"]
        command = [sys.executable, "-m", "pip", *asked, "--report", report, "-r", wanted]
        subprocess.run([str(word) for word in command], check=True)
        items = json.loads(report.read_text())["install"]
    return {
        normal(item["metadata"]["name"]): item["download_info"]["archive_info"]["hashes"]["sha256"]
        for item in items
    }
