"""What an export writes for each target: C alone, or the same C inside of something else."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any, Final, NamedTuple

from undeadzone.errors import FileError
from undeadzone.scenario.schema import Units
from undeadzone.util.files import read_text, require_folder, writing
from undeadzone.util.own_files import CURE, digest, edited_files
from undeadzone.util.text import one_line, printable
from undeadzone_export import plc, plcopen
from undeadzone_export.code import Code
from undeadzone_export.exported_step import Field
from undeadzone_export.fmu import package
from undeadzone_export.selftest_vectors import Vectors, selftest
from undeadzone_export.source import Labels, Source
from undeadzone_export.template import call_words, fill_template

Files = dict[str, str | bytes]
GENERATOR = "undeadzone export"
MANIFEST = "manifest.json"


def manifest(report: dict[str, Any]) -> str:
    """Return the text of the manifest."""
    return _text({"generator": GENERATOR} | report)


def require_replaceable(out: Path, force: bool = False) -> None:
    """Raise FileError unless a folder can be written, and is absent, empty or an earlier export.

    Args:
        out: the folder.
        force: whether files of the export that were edited are replaced, too, and whether others
            may be put into any folder.
    """
    if out.exists() and not out.is_dir():
        raise FileError(f"{out}: is a file; give another folder")
    require_folder(out)
    if not out.exists():
        return
    if force or all(path.name.startswith(".") for path in out.iterdir()):
        return
    written = _written_digests(out)
    if not written:
        raise FileError(
            f"{out}: holds no {MANIFEST} of `{GENERATOR}` as it was written, so it is not "
            f"replaced; {CURE}"
        )
    changed = edited_files(out, written)
    if changed:
        raise FileError(f"{out / changed[0]}: someone edited it; {CURE}")


def _written_digests(out: Path) -> dict[str, str]:
    """Return the digests of an export's files by path; none where its manifest is not as
    written.
    """
    try:
        text = read_text(out / MANIFEST)
        content = json.loads(text)
        is_whole = text == _text(content) and content["generator"] == GENERATOR
        written = content["files"]
        own, written[MANIFEST] = written[MANIFEST], ""
        if not is_whole or own != digest(_text(content).encode()):
            return {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {path: value for path, value in written.items() if path != MANIFEST}


def _sign_manifest(files: Files) -> Files:
    """Return the files with the digest of each in the manifest, its own with nothing in that
    place.
    """
    content = json.loads(files[MANIFEST])
    content["files"] = {path: digest(_bytes(text)) for path, text in sorted(files.items())}
    content["files"][MANIFEST] = ""
    content["files"][MANIFEST] = digest(_text(content).encode())
    return files | {MANIFEST: _text(content)}


def _text(content: dict[str, Any]) -> str:
    """Return the text of a manifest."""
    return json.dumps(content, indent=2) + "\n"


def _bytes(content: str | bytes) -> bytes:
    """What a file holds, in bytes."""
    return content.encode() if isinstance(content, str) else content


def write_folder(files: Files, out: Path, force: bool = False) -> list[Path]:
    """Write files into a folder; each takes its place once all are written beside.

    Args:
        files: texts and bytes by their paths inside the folder, a manifest among them.
        out: the folder; of an earlier export there its files are replaced, all others stay.
        force: whether files in their places are replaced that someone else wrote or edited.

    Returns:
        The paths written.

    Raises:
        FileError: it cannot be written, or `out` or a file there is something else.
    """
    require_replaceable(out, force)
    before = _written_digests(out)
    own = {MANIFEST, *before} - set(edited_files(out, before))
    for path in files:
        if (out / path).parent.resolve() != out.resolve() / Path(path).parent:
            raise FileError(f"{out / path}: a link leads elsewhere; give another folder")
        if not force and path not in own and (out / path).exists():
            raise FileError(f"{out / path}: exists already, and someone else wrote it; {CURE}")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out, prefix=".fresh-") as name:
            fresh = Path(name)
            for path, content in _sign_manifest(files).items():
                (fresh / path).parent.mkdir(parents=True, exist_ok=True)
                (fresh / path).write_bytes(_bytes(content))
            for path in own - files.keys():
                (out / path).unlink(missing_ok=True)
            for path in sorted(files, key=MANIFEST.__eq__):  # the manifest last
                (out / path).parent.mkdir(parents=True, exist_ok=True)
                os.replace(fresh / path, out / path)
    return [out / path for path in files]


PRECISION: Final = {
    "c": "single",
    "arduino": "single",
    "fmu2": "double",
    "fmu3": "double",
    "python": "double",
    "st": "single",
    "page": "double",
}
VERSIONS: Final = {"fmu2": 2, "fmu3": 3}  # of FMI


class Material(NamedTuple):
    """What the files of an export are made of.

    Attributes:
        printed: the graphs.
        labels: the words that the files share.
        text: the C.
        vectors: the reference vectors of the self-test.
        units: names of the scenario's units.
        report: what the manifest holds; `files` is added to it.
    """

    printed: Code
    labels: Labels
    text: Source
    vectors: Vectors
    units: Units
    report: dict[str, Any]

    @property
    def c_files(self) -> dict[str, str]:
        """Return the C by the names of its files, with the self-test."""
        name = self.report["name"]
        test = selftest(self.printed, name, self.vectors)
        return self.text.files() | {f"{name}_test.c": test}


def files(to: str, material: Material) -> Files:
    """Return the files of an export by their paths in its folder.

    Args:
        to: the target.
        material: what they are made of.

    Raises:
        InputError: the C compiler refuses an FMU, or Structured Text lacks an operation.
    """
    report, name = material.report, material.report["name"]
    code = material.text.files()
    content: Files = dict(code)
    if to == "arduino":
        content = {f"src/{path}": text for path, text in code.items()}
        test = f"{name}_test.c"
        content[f"examples/{name}_test/{test}"] = material.c_files[test]
        around = _arduino_files(report)
    elif to == "c":
        content = dict(material.c_files)
        around = _build_files(report, bool(material.text.math))
    elif to == "st":
        content, around = _st_files(material)
    elif to == "python":
        content[f"{name}.py"] = _module(material.printed, report)
        around = {"README.md": _installation_text("python", {"name": name}, report)}
    else:
        version = VERSIONS[to]
        unit = package.package(material.printed, code, report, material.units, version)
        content = {f"{name}.fmu": unit}
        around = {
            "README.md": _installation_text("fmu", {"name": name, "version": version}, report)
        }
    report["files"] = sorted({*content, *around, MANIFEST})
    return content | around | {MANIFEST: manifest(report)}


def _readme(report: dict[str, Any], build: str = "") -> str:
    """Return the README; of what is built, how: by default by make, with the self-test."""
    by_make = f"Run `make && ./{report['name']}_test`: exit code 0 means that every bit agrees."
    words = {"build": build or by_make, "by_make": not build}
    return fill_template("templates/README.md", _words(report) | words)


def _words(report: dict[str, Any]) -> dict[str, Any]:
    """What stands for the words of the texts."""
    counts = ", ".join(f"{count} {word}" for word, count in report["operations"].items())
    shown = {"shown_title": printable(report["title"]), "seconds": f"{report['step']:g}"}
    shown |= {"counts": counts, "upper": report["name"].upper()}
    shown |= {f"{struct}_bytes": size for struct, size in report["sizes"].items()}
    return report | call_words(report["name"], bool(report["tunable"])) | shown


def _build_files(report: dict[str, Any], math: bool) -> dict[str, str]:
    """Return the texts of Makefile, CMakeLists.txt and README.md, by name."""
    words = _words(report)
    words["math"] = f"{report['name']}_math.h " if math else ""
    return {
        "Makefile": fill_template("templates/Makefile", words),
        "CMakeLists.txt": fill_template("templates/CMakeLists.txt", words),
        "README.md": _readme(report),
    }


def _arduino_files(report: dict[str, Any]) -> dict[str, str]:
    """Return the texts around the C of an Arduino library, by name."""
    name = report["name"]
    words = _words(report) | {"title": one_line(str(report["title"]))}
    build = (
        "Copy this folder into the libraries folder of the Arduino IDE. The example\n"
        f"{name}_test runs the self-test on the board and prints its verdict."
    )
    return {
        "library.properties": fill_template("templates/library.properties", words),
        f"examples/{name}_example/{name}_example.ino": fill_template(
            "templates/example.ino", words
        ),
        f"examples/{name}_test/{name}_test.ino": fill_template("templates/selftest.ino", words),
        "README.md": _readme(report, build),
    }


def _st_files(material: Material) -> tuple[Files, dict[str, str]]:
    """Return (the Structured Text, its README) by name; the report gets its sizes."""
    report, labels, printed = material.report, material.labels, material.printed
    made = plc.export_plc(printed, labels, material.vectors)
    name, text = labels.prefix, plcopen.text_of(made.units, labels, printed)
    report["structured_text"] = {"blocks": made.blocks, "lines": text.count("\n")}
    content: Files = {
        f"{name}.st": text,
        f"{name}_test.st": plcopen.text_of([made.test], labels, printed),
        f"{name}.xml": plcopen.xml_of([*made.units, made.test], labels, printed),
    }
    words = _words(report) | {
        "blocks": made.blocks,
        "type": "REAL" if printed.single else "LREAL",
        "samples": len(material.vectors.states),
        "argument": f"{printed.step.inputs[1].name}_0",
        "parted": made.blocks > 1,
        "single": printed.single,
        "double": not printed.single,
    }
    return content, {"README.md": fill_template("templates/st.md", words)}


def _installation_text(kind: str, words: dict[str, Any], report: dict[str, Any]) -> str:
    """Return the README of what takes more than the C."""
    return _readme(report, fill_template(f"templates/{kind}.md", words).rstrip("\n"))


# --- `--to python`: a module that compiles the exported C and calls it, without undeadzone


def _module(printed: Code, report: dict[str, Any]) -> str:
    """Return the text of the module.

    Args:
        printed: what is printed as C.
        report: what the manifest holds.
    """
    structs = printed.structs
    words = {key: report[key] for key in ("name", "version", "part")} | {
        "title": _plain(report["title"]),
        "hash": repr(report["hash"]),
        "step": repr(report["step"]),
        "seconds": f"{report['step']:g}",
        "arguments": ", ".join(field.name for field in structs["in"]),
        "inputs": _list_fields(structs["in"]),
        "outputs": _list_fields(structs["out"]),
        "real": f"c_{printed.real}",
    }
    for name in ("state", "in", "out", "params"):
        words[f"fields_of_{name}"] = _sizes(structs.get(name, []))
    return fill_template("templates/python_module.txt", words)


def _sizes(fields: list[Field]) -> list[tuple[str, int]]:
    """Names and sizes of the arrays of a struct."""
    return [(field.name, field.size) for field in fields]


def _list_fields(fields: list[Field]) -> str:
    """Return fields in words, a line each."""
    return "".join(
        f"\n    {field.name} ({field.size}): {_plain(field.meaning)}" for field in fields
    )


def _plain(text: str) -> str:
    """Return a text that ends no docstring."""
    return one_line(text).replace("\\", "/").replace('"', "'")
