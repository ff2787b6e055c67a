"""A bill of materials of a wheel and of all that it brings, in CycloneDX 1.6.

The same wheel and the same versions give the same bytes: no time, and a serial number of contents.
"""

from __future__ import annotations

import hashlib
import json
import uuid
import zipfile
from email.message import Message
from email.parser import Parser
from importlib.metadata import Distribution
from pathlib import Path
from typing import Any, Final

from packaging.requirements import Requirement

from tools.supply import hashes
from tools.supply.parts import needed, normal, pinned

VERSION: Final = "1.6"
LICENCE: Final = "License :: "


def write(wheel: Path) -> Path:
    """Write the bill beside a wheel, and say where."""
    path = wheel.with_suffix(".cdx.json")
    path.write_text(json.dumps(bill(wheel), indent=2) + "\n", encoding="utf-8")
    return path


def bill(wheel: Path) -> dict[str, Any]:
    """The bill of a wheel, with the versions of constraints.txt."""
    about = _metadata(wheel)
    required = [text for text in about.get_all("Requires-Dist", []) if "extra ==" not in text]
    found, versions = needed(required), pinned()
    checked = hashes.read(hashes.RUNTIME)
    whole = _component(about["Name"], about["Version"], about["Summary"])
    whole["licenses"] = [{"expression": about["License-Expression"]}]
    whole["hashes"] = [_hash(hashlib.sha256(wheel.read_bytes()).hexdigest())]
    parts = []
    for name, each in found.items():
        part = _component(name, versions[name], each.metadata["Summary"])
        part["hashes"] = [_hash(value) for value in checked[name][1]]
        part["licenses"] = _licences(each)
        parts.append(part)
    own = {"ref": whole["bom-ref"], "dependsOn": _refs(required, versions)}
    others = [
        {
            "ref": part["bom-ref"],
            "dependsOn": _refs(found[part["name"]].requires or (), versions, found),
        }
        for part in parts
    ]
    content = {
        "metadata": {"component": whole | {"type": "library"}},
        "components": parts,
        "dependencies": [own, *others],
    }
    serial = uuid.uuid5(uuid.NAMESPACE_OID, json.dumps(content, sort_keys=True))
    head = {"bomFormat": "CycloneDX", "specVersion": VERSION, "version": 1}
    return head | {"serialNumber": f"urn:uuid:{serial}"} | content


def _metadata(wheel: Path) -> Message:
    """What a wheel says of itself."""
    with zipfile.ZipFile(wheel) as archive:
        (path,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        return Parser().parsestr(archive.read(path).decode("utf-8"))


def _component(name: str, version: str, summary: str) -> dict[str, Any]:
    """A distribution as a component."""
    address = f"pkg:pypi/{normal(name)}@{version}"
    return {
        "type": "library",
        "bom-ref": address,
        "name": name,
        "version": version,
        "description": summary,
        "purl": address,
    }


def _licences(owner: Distribution) -> list[dict[str, Any]]:
    """The licence of a distribution, as it names it: an expression, or words."""
    about = owner.metadata
    expression = about.get("License-Expression")
    if expression:
        return [{"expression": expression}]
    every = [
        line.rsplit(" :: ", 1)[1] for line in about.get_all("Classifier", []) if LICENCE in line
    ]
    named = [word for word in every if word != "OSI Approved"]
    return [
        {"license": {"name": word}}
        for word in named or (about.get("License") or "").split("\n")[:1]
    ]


def _refs(requirements: Any, versions: dict[str, str], among: Any = None) -> list[str]:
    """The addresses of what is required, of those that are listed."""
    names = {normal(Requirement(text).name) for text in requirements}
    kept = names if among is None else names & among.keys()
    return [f"pkg:pypi/{name}@{versions[name]}" for name in sorted(kept)]


def _hash(value: str) -> dict[str, str]:
    """A hash as the format writes it."""
    return {"alg": "SHA-256", "content": value}
