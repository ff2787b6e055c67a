"""FMU archive: model description, a binary for this computer, and the C sources."""

from __future__ import annotations

import io
import platform
import sys
import uuid
import zipfile
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from undeadzone.errors import InputError
from undeadzone.interfaces import COLUMNS, QUANTITIES, Estimate
from undeadzone.results.signals import quantity_unit
from undeadzone.scenario.schema import Units
from undeadzone.util.files import open_scratch
from undeadzone.util.text import to_one_line
from undeadzone_export import compiler
from undeadzone_export.code import Code
from undeadzone_export.exported_step import ExportedStep, Field, field_entries, total_size
from undeadzone_export.template import fill_template, read_template

_NO_XML: Final = str.maketrans("\ufffe\uffff", "??")  # characters that no XML may hold

# Capabilities: names differ between the versions in one letter.
_CAN: Final = {
    2: ("canNotUseMemoryManagementFunctions", "canGetAndSetFMUstate", "canSerializeFMUstate"),
    3: ("canGetAndSetFMUState", "canSerializeFMUState"),
}


_NO_DEPENDENCIES: Final = {"dependencies": ""}


# Fields of an estimate that a table calls otherwise; widths keep their names.
RENAMED: Final = {
    name: getattr(COLUMNS, name) for name in Estimate._fields if name in ("x", "z", "w", "theta")
}
KINDS: Final = {
    **{name: quantity.unit for name, quantity in QUANTITIES.items()},
    **{"y": "output", "r": "output", "u": "input", "u_ff": "input", "x_ref": "state"},
}


class FmuVariable(NamedTuple):
    """Variable of an FMU.

    Attributes:
        name: as importers show it.
        causality: "input", "output" or "parameter".
        meaning: its meaning.
        unit: its unit (empty: it has none).
        start: its value at first (None for outputs, which are calculated).
        is_flag: whether it is a Boolean.
    """

    name: str
    causality: str
    meaning: str
    unit: str
    start: float | None
    is_flag: bool = False


def list_fmu_variables(step: ExportedStep, units: Units) -> list[FmuVariable]:
    """Return all variables of a step in the order of their references, which count from 0.

    Args:
        step: the step.
        units: names of the scenario's units.
    """
    listed = [_entry_variable(*each, "input", units, 0.0) for each in field_entries(step.inputs)]
    listed += [
        _entry_variable(*each, "output", units, None) for each in field_entries(step.outputs)
    ]
    starts = zip(field_entries(step.params), step.defaults.tolist(), strict=True)
    listed += [_entry_variable(*each, "parameter", units, start) for each, start in starts]
    for k in range(step.readings):
        meaning = f"whether reading y[{k}] is missing"
        listed.append(FmuVariable(f"missing[{k}]", "input", meaning, "", 0.0, is_flag=True))
    return listed


def _entry_variable(
    field: Field, k: int, causality: str, units: Units, start: float | None
) -> FmuVariable:
    """Return the FMU variable of an entry of a field."""
    name = field.name
    if causality == "output":
        name = RENAMED.get(name, name)
    kind = "1" if causality == "parameter" else KINDS.get(field.name, "1")
    unit = quantity_unit(kind, k, units)
    meaning = field.meaning.split(" [")[0]
    return FmuVariable(f"{name}[{k}]", causality, meaning, "" if unit == "1" else unit, start)


# --- As XML


def instantiation_token(report: dict[str, Any], version: int) -> str:
    """Return the token that ties description and binary together, computed from the hash.

    Args:
        report: name, hash and version of the export.
        version: of FMI, 2 or 3.
    """
    words = (report["name"], report["hash"], report["version"], f"fmi{version}")
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_OID, " ".join(words))) + "}"


def model_description(
    report: dict[str, Any], listed: list[FmuVariable], sources: list[str], version: int
) -> str:
    """Return the text of modelDescription.xml.

    Args:
        report: content of the manifest.
        listed: the variables, in the order of their references.
        sources: names of the C files to be compiled.
        version: of FMI, 2 or 3.
    """
    name = report["name"]
    token = "guid" if version == 2 else "instantiationToken"
    head = {
        "fmiVersion": f"{version}.0",
        "modelName": name,
        token: instantiation_token(report, version),
        "description": _to_xml_line(str(report["title"])),
        "generationTool": f"undeadzone {report['version']}",
        "variableNamingConvention": "flat",
    }
    root = Element("fmiModelDescription", head)
    kind = SubElement(root, "CoSimulation", {"modelIdentifier": name})
    for word in ("canHandleVariableCommunicationStepSize", *_CAN[version]):
        kind.set(word, "true")
    if version == 2:
        files = SubElement(kind, "SourceFiles")
        for source in sources:
            SubElement(files, "File", {"name": source})
    else:
        kind.set("fixedInternalStepSize", repr(report["step"]))
    _add_units(root, listed, version)
    times = {"startTime": "0.0", "stepSize": repr(report["step"])}
    SubElement(root, "DefaultExperiment", times)
    parent = SubElement(root, "ModelVariables")
    for reference, variable in enumerate(listed):
        _add_fmu_variable(parent, reference, variable, version)
    if version == 3:
        attributes = {"name": "time", "valueReference": str(len(listed))}
        attributes |= {"causality": "independent", "variability": "continuous", "unit": "s"}
        SubElement(parent, "Float64", attributes)
    _add_structure(root, listed, version)
    return _xml_document(root)


def _add_units(root: Element, listed: list[FmuVariable], version: int) -> None:
    """Add the units that variables name. In FMI 3 time is a variable, too."""
    names = {_to_xml_line(variable.unit) for variable in listed if variable.unit}
    if version == 3:
        names.add("s")
    if names:
        parent = SubElement(root, "UnitDefinitions")
        for name in sorted(names):
            SubElement(parent, "Unit", {"name": name})


def _add_fmu_variable(parent: Element, reference: int, variable: FmuVariable, version: int) -> None:
    """Add a variable. Its type is a child element in FMI 2 and the element's name in FMI 3."""
    is_parameter = variable.causality == "parameter"
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": _to_xml_line(variable.meaning),
        "causality": variable.causality,
        "variability": "tunable" if is_parameter else "discrete",
    }
    typed: dict[str, str] = {}
    if variable.unit:
        typed["unit"] = _to_xml_line(variable.unit)
    if variable.start is None:
        attributes["initial"] = "calculated"
    else:
        typed["start"] = "false" if variable.is_flag else repr(variable.start)
    if version == 2:
        inner = "Boolean" if variable.is_flag else "Real"
        SubElement(SubElement(parent, "ScalarVariable", attributes), inner, typed)
    else:
        kind = "Boolean" if variable.is_flag else "Float64"
        SubElement(parent, kind, attributes | typed)


def _add_structure(root: Element, listed: list[FmuVariable], version: int) -> None:
    """Add the outputs. They depend on no present input: they belong to the last sample."""
    parent = SubElement(root, "ModelStructure")
    outputs = [k for k, variable in enumerate(listed) if variable.causality == "output"]
    for word, known in (("Output", _NO_DEPENDENCIES), ("InitialUnknown", {})):
        group = SubElement(parent, f"{word}s") if version == 2 else parent
        for k in outputs:
            if version == 2:
                SubElement(group, "Unknown", {"index": str(k + 1), **known})
            else:
                SubElement(group, word, {"valueReference": str(k), **known})


def _to_xml_line(text: str) -> str:
    """Return a text on one line without characters that XML forbids."""
    return to_one_line(text).translate(_NO_XML)


def build_description(name: str, sources: list[str]) -> str:
    """Return the text of sources/buildDescription.xml of FMI 3.0.

    Args:
        name: the model's identifier.
        sources: names of the C files to be compiled.
    """
    root = Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    built = SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    files = SubElement(built, "SourceFileSet", {"language": "C99"})
    for source in sources:
        SubElement(files, "SourceFile", {"name": source})
    return _xml_document(root)


def _xml_document(root: Element) -> str:
    """Return the text of an XML document."""
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


PLATFORMS = {  # names of folders in FMI 2.0; those of 3.0 begin with the architecture
    "linux": ("linux", ".so"),
    "darwin": ("darwin", ".dylib"),
    "win32": ("win", ".dll"),
}


def binary_path(prefix: str, version: int) -> str:
    """Return the path of this computer's binary in an FMU.

    Raises InputError if FMI has no name for this computer.

    Args:
        prefix: the model's identifier.
        version: of FMI, 2 or 3.
    """
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    known = PLATFORMS.get(sys.platform)
    if known is None or (version == 2 and machine != "x86_64"):
        raise InputError(
            f"to: FMI {version} has no folder for binaries of {sys.platform} on {machine}. "
            "Use --to fmu3, or --to c"
        )
    system, ending = known
    folder = f"{system}64"
    if version == 3:
        folder = f"{machine}-{'windows' if system == 'win' else system}"
    return f"binaries/{folder}/{prefix}{ending}"


def require_buildable(prefix: str, version: int) -> None:
    """Raise InputError if a C compiler or a folder name for the FMU is missing.

    Args:
        prefix: the model's identifier.
        version: of FMI, 2 or 3.
    """
    compiler.require_compiler()
    binary_path(prefix, version)


def build_fmu(
    printed: Code, files: dict[str, str], report: dict[str, Any], units: Units, version: int
) -> bytes:
    """Build the FMU and return its bytes.

    Args:
        printed: the printed nodes.
        files: the C files by name.
        report: content of the manifest.
        units: names of the scenario's units.
        version: of FMI, 2 or 3.

    Raises:
        InputError: there is no C compiler, or it refuses.
    """
    prefix = report["name"]
    listed = list_fmu_variables(printed.step, units)
    sources = files | {"fmu_model.h": _model_header(printed, report, version)}
    for name in ("fmu.h", f"fmi{version}.h", f"fmi{version}.c"):
        sources[name] = read_template(f"fmu/{name}")
    compiled = sorted(name for name in sources if name.endswith(".c"))
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": model_description(report, listed, compiled, version)
    }
    contents[binary_path(prefix, version)] = _build_binary(sources)
    if version == 3:
        contents["sources/buildDescription.xml"] = build_description(prefix, compiled)
    contents |= {f"sources/{name}": text for name, text in sorted(sources.items())}
    return _zip_contents(contents)


def _model_header(printed: Code, report: dict[str, Any], version: int) -> str:
    """Return the text of fmu_model.h."""
    step = printed.step
    words = report | {
        "token": instantiation_token(report, version),
        "tunable": bool(step.params),
        "fixed": not step.params,
        "inputs": total_size(step.inputs),
        "readings": step.readings,
        "outputs": total_size(step.outputs),
        "params": total_size(step.params),
        "real": printed.c_type,
    }
    return fill_template("templates/fmu_model.h", words)


def _build_binary(sources: dict[str, str]) -> bytes:
    """Compile the shared library and return its bytes."""
    with open_scratch() as scratch:
        files = compiler.write_sources(sources, scratch)
        options = ("-O2", "-fvisibility=hidden")
        return compiler.compile_library(sorted(files), scratch / "model.so", options).read_bytes()


def _zip_contents(contents: dict[str, str | bytes]) -> bytes:
    """Pack files into a zip archive whose bytes depend on the contents only."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in contents.items():
            entry = zipfile.ZipInfo(path)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
    return memory.getvalue()
