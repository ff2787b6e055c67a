"""Files of an export for each target: C alone, or the same C inside another format."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any, Final, NamedTuple

from undeadzone.errors import FileError
from undeadzone.scenario.schema import Units
from undeadzone.util.files import convert_write_errors, read_text, require_folder
from undeadzone.util.own_files import CURE, content_digest, list_edited_files
from undeadzone.util.text import escape_controls, to_one_line
from undeadzone_export import plc, plcopen
from undeadzone_export.code import Code
from undeadzone_export.exported_step import Field
from undeadzone_export.fmu import package
from undeadzone_export.selftest_vectors import Vectors, selftest_source
from undeadzone_export.source import Labels, Source
from undeadzone_export.template import call_words, fill_template

Files = dict[str, str | bytes]
GENERATOR = "undeadzone export"
MANIFEST = "manifest.json"


def manifest_text(report: dict[str, Any]) -> str:
    """Return the text of the manifest."""
    return _manifest_json({"generator": GENERATOR} | report)


def require_replaceable(out: Path, force: bool = False) -> None:
    """Raise FileError unless a folder is writable, and absent, empty or an earlier export.

    Args:
        out: the folder.
        force: whether files of the export that were edited are replaced, too, and whether others
            may be put into any folder.
    """
    if out.exists() and not out.is_dir():
        raise FileError(f"{out}: is a file. Give another folder")
    require_folder(out)
    if force or not out.exists() or all(path.name.startswith(".") for path in out.iterdir()):
        return
    written = _earlier_digests(out)
    if not written:
        raise FileError(
            f"{out}: holds no {MANIFEST} of `{GENERATOR}` as it was written, so it is not "
            f"replaced; {CURE}"
        )
    changed = list_edited_files(out, written)
    if changed:
        raise FileError(f"{out / changed[0]}: someone edited it; {CURE}")


def _earlier_digests(out: Path) -> dict[str, str]:
    """Return the digests of an earlier export by path, or none if its manifest was changed."""
    try:
        text = read_text(out / MANIFEST)
        content = json.loads(text)
        is_whole = text == _manifest_json(content) and content["generator"] == GENERATOR
        written = content["files"]
        own = written[MANIFEST]
        written[MANIFEST] = ""
        if not is_whole or own != content_digest(_manifest_json(content).encode()):
            return {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {path: value for path, value in written.items() if path != MANIFEST}


def _add_digests(files: Files) -> Files:
    """Add the digest of each file to the manifest.

    The manifest's own digest is computed with that entry empty.
    """
    content = json.loads(files[MANIFEST])
    content["files"] = {
        path: content_digest(_to_bytes(text)) for path, text in sorted(files.items())
    }
    content["files"][MANIFEST] = ""
    content["files"][MANIFEST] = content_digest(_manifest_json(content).encode())
    return files | {MANIFEST: _manifest_json(content)}


def _manifest_json(content: dict[str, Any]) -> str:
    """Return the text of a manifest's content."""
    return json.dumps(content, indent=2) + "\n"


def _to_bytes(content: str | bytes) -> bytes:
    """Convert the content of a file to bytes."""
    return content.encode() if isinstance(content, str) else content


def write_folder(files: Files, out: Path, force: bool = False) -> list[Path]:
    """Write files into a folder.

    Each is moved to its place after all are written to a temporary folder.

    Args:
        files: texts and bytes by their paths inside the folder, a manifest among them.
        out: the folder, in which the files of an earlier export are replaced and all others stay.
        force: whether files in their places are replaced that someone else wrote or edited.

    Returns:
        The paths written.

    Raises:
        FileError: it cannot be written, or `out` or a file there is something else.
    """
    require_replaceable(out, force)
    before = _earlier_digests(out)
    own = {MANIFEST, *before} - set(list_edited_files(out, before))
    for path in files:
        if (out / path).parent.resolve() != out.resolve() / Path(path).parent:
            raise FileError(f"{out / path}: a link leads elsewhere. Give another folder")
        if not force and path not in own and (out / path).exists():
            raise FileError(f"{out / path}: exists already, and someone else wrote it; {CURE}")
    with convert_write_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out, prefix=".fresh-") as name:
            fresh = Path(name)
            for path, content in _add_digests(files).items():
                (fresh / path).parent.mkdir(parents=True, exist_ok=True)
                (fresh / path).write_bytes(_to_bytes(content))
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
    """Parts from which the files of an export are written.

    Attributes:
        printed: the graphs.
        labels: the words that the files share.
        text: the C.
        vectors: the reference vectors of the self-test.
        units: names of the scenario's units.
        report: content of the manifest (`files` is added to it).
        proof: what is proved about the C, by file name, beside it.
    """

    printed: Code
    labels: Labels
    text: Source
    vectors: Vectors
    units: Units
    report: dict[str, Any]
    proof: Files

    @property
    def c_files(self) -> dict[str, str]:
        """Return the C texts by file name, with the self-test."""
        name = self.report["name"]
        test = selftest_source(self.printed, name, self.vectors)
        return self.text.texts_by_name() | {f"{name}_test.c": test}


def export_files(to: str, material: Material) -> Files:
    """Return the files of an export by their paths in its folder.

    Args:
        to: the target.
        material: parts of the export.

    Raises:
        InputError: the C compiler refuses an FMU, or Structured Text lacks an operation.
    """
    report = material.report
    name = report["name"]
    code = material.text.texts_by_name()
    content: Files = dict(code)
    if to == "arduino":
        content = {f"src/{path}": text for path, text in {**code, **material.proof}.items()}
        test = f"{name}_test.c"
        content[f"examples/{name}_test/{test}"] = material.c_files[test]
        around = _arduino_files(report)
    elif to == "c":
        content = {**material.c_files, **material.proof}
        around = _build_system_files(report, bool(material.text.math))
    elif to == "st":
        content, around = _st_files(material)
    elif to == "python":
        content |= material.proof
        content[f"{name}.py"] = _python_module(material.printed, report)
        around = {"README.md": _target_readme("python", {"name": name}, report)}
    else:
        version = VERSIONS[to]
        unit = package.build_fmu(material.printed, code, report, material.units, version)
        content = {f"{name}.fmu": unit}
        around = {"README.md": _target_readme("fmu", {"name": name, "version": version}, report)}
    report["files"] = sorted({*content, *around, MANIFEST})
    return content | around | {MANIFEST: manifest_text(report)}


def _readme_text(report: dict[str, Any], build: str = "") -> str:
    """Return the README with build instructions: make and the self-test by default."""
    by_make = f"Run `make && ./{report['name']}_test`: exit code 0 means that every bit agrees."
    words = {"build": build or by_make, "by_make": not build}
    return fill_template("templates/README.md", _template_words(report) | words)


def operations_text(report: dict[str, Any]) -> str:
    """Return the operations of a step in words.

    Args:
        report: of an export or a page.
    """
    return ", ".join(f"{count} {word}" for word, count in report["operations"].items())


def _template_words(report: dict[str, Any]) -> dict[str, Any]:
    """Return the values of the words in the templates."""
    words = {"shown_title": escape_controls(report["title"]), "seconds": f"{report['step']:g}"}
    words |= {"counts": operations_text(report), "upper": report["name"].upper()}
    words |= {f"{struct}_bytes": size for struct, size in report["sizes"].items()}
    return report | call_words(report["name"], bool(report["tunable"])) | words


def _build_system_files(report: dict[str, Any], has_math: bool) -> dict[str, str]:
    """Return the texts of Makefile, CMakeLists.txt and README.md, by name.

    Args:
        report: numbers and names of the export.
        has_math: whether the C includes a header with elementary functions.
    """
    words = _template_words(report)
    words["math"] = f"{report['name']}_math.h " if has_math else ""
    return {
        name: fill_template(f"templates/{name}", words) for name in ("Makefile", "CMakeLists.txt")
    } | {"README.md": _readme_text(report)}


def _arduino_files(report: dict[str, Any]) -> dict[str, str]:
    """Return the texts around the C of an Arduino library, by name."""
    name = report["name"]
    words = _template_words(report) | {"title": to_one_line(str(report["title"]))}
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
        "README.md": _readme_text(report, build),
    }


def _st_files(material: Material) -> tuple[Files, dict[str, str]]:
    """Return the Structured Text and its README, by name. Add their sizes to the report."""
    report = material.report
    labels = material.labels
    printed = material.printed
    program = plc.export_plc(printed, labels, material.vectors)
    name = labels.prefix
    text = plcopen.st_text(program.units, labels, printed)
    report["structured_text"] = {"blocks": program.block_count, "lines": text.count("\n")}
    content: Files = {
        f"{name}.st": text,
        f"{name}_test.st": plcopen.st_text([program.test], labels, printed),
        f"{name}.xml": plcopen.plcopen_xml([*program.units, program.test], labels, printed),
    }
    words = _template_words(report) | {
        "blocks": program.block_count,
        "type": "REAL" if printed.single else "LREAL",
        "samples": len(material.vectors.states),
        "further": "".join(f", {one.name}_0 := value" for one in printed.step.inputs[1:2]),
        "parted": program.block_count > 1,
        "single": printed.single,
        "double": not printed.single,
    }
    return content, {"README.md": fill_template("templates/st.md", words)}


def _target_readme(kind: str, words: dict[str, Any], report: dict[str, Any]) -> str:
    """Return the README of a target that needs more than the C."""
    return _readme_text(report, fill_template(f"templates/{kind}.md", words).rstrip("\n"))


# --- `--to python`: a module that compiles the exported C and calls it, without undeadzone


def _python_module(printed: Code, report: dict[str, Any]) -> str:
    """Return the text of the Python module.

    Args:
        printed: the nodes printed as C.
        report: content of the manifest.
    """
    structs = printed.structs
    words = {key: report[key] for key in ("name", "version", "part")} | {
        "title": _to_docstring_line(report["title"]),
        "hash": repr(report["hash"]),
        "step": repr(report["step"]),
        "seconds": f"{report['step']:g}",
        "arguments": ", ".join(field.name for field in structs["in"]),
        "inputs": _field_lines(structs["in"]),
        "outputs": _field_lines(structs["out"]),
        "real": f"c_{printed.c_type}",
    }
    for name in ("state", "in", "out", "params"):
        words[f"fields_of_{name}"] = [field[:2] for field in structs.get(name, [])]
    return fill_template("templates/python_module.txt", words)


def _field_lines(fields: list[Field]) -> str:
    """Return a line of text for each field."""
    return "".join(
        f"\n    {field.name} ({field.size}): {_to_docstring_line(field.meaning)}"
        for field in fields
    )


def _to_docstring_line(text: str) -> str:
    """Return a text on one line that cannot end a docstring."""
    return to_one_line(text).replace("\\", "/").replace('"', "'")
