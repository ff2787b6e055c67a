"""Files of Structured Text: as text, and as XML of PLCopen (TC6, version 2.01)."""

from __future__ import annotations

import itertools
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import undeadzone
from undeadzone.compile.print_c import wrap_statement
from undeadzone.compile.print_st import TYPES
from undeadzone.util.text import to_one_line
from undeadzone_export.code import Code
from undeadzone_export.plc import PlcUnit, PlcVariable
from undeadzone_export.source import Labels
from undeadzone_export.template import fill_template

_XHTML: Final = "http://www.w3.org/1999/xhtml"
_SECTIONS: Final = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
_KINDS: Final = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


def st_text(units: list[PlcUnit], labels: Labels, code: Code) -> str:
    """Return the text of a file of Structured Text.

    Args:
        units: units of the file.
        labels: the words that the files share.
        code: the printed nodes.
    """
    head = [
        f"{labels.prefix}: {labels.part}, {TYPES[code.dtype_name]}; hash {code.hash}.",
        f"Written by undeadzone {undeadzone.__version__}; do not edit.",
        "SPDX-License-Identifier: BSD-3-Clause",
    ]
    lines = [_comment_text("\n   ".join(head))]
    for unit in units:
        lines += ["", _comment_text(_to_ascii_remark(unit.meaning)), *_unit_lines(unit)]
    return "\n".join([*lines, ""])


def _unit_lines(unit: PlcUnit) -> list[str]:
    """Return the lines of a unit."""
    returned = f" : {unit.returns}" if unit.returns else ""
    lines = [f"{unit.keyword} {unit.name}{returned}"]
    for section, variables in unit.variables.items():
        if variables:
            alike = itertools.groupby(variables, _declaration_parts)
            declared = [_declaration_lines(list(group), text) for text, group in alike]
            lines += [section, *itertools.chain(*declared), "END_VAR"]
    return [*lines, *unit.lines, f"END_{unit.keyword}"]


def _declaration_parts(variable: PlcVariable) -> tuple[str, str]:
    """Return type and start value of a variable, and its meaning as a comment."""
    start = ", ".join(variable.start)
    given = f" := [{start}]" if variable.is_array else f" := {start}"
    remark = f" {_comment_text(_to_ascii_remark(variable.meaning))}" if variable.meaning else ""
    return f"{variable.kind}{given if variable.start else ''};", remark


def _declaration_lines(variables: list[PlcVariable], declared: tuple[str, str]) -> list[str]:
    """Return the lines that declare variables with different names."""
    kind, remark = declared
    *lines, last = wrap_statement(f"{', '.join(each.name for each in variables)} : {kind}")
    return [*lines, last + remark]


def _to_ascii_remark(text: str) -> str:
    """Return a text on one line that cannot end a comment, in ASCII for old editors."""
    line = to_one_line(text).encode("ascii", "replace").decode()
    return line.replace("*)", "* )").replace("(*", "( *")


def _comment_text(text: str) -> str:
    """Return a comment."""
    return f"(* {text} *)"


# --- As XML


def plcopen_xml(units: list[PlcUnit], labels: Labels, code: Code) -> str:
    """Return the text of a file that development systems import.

    Args:
        units: units of the file.
        labels: the words that the files share.
        code: the printed nodes.
    """
    pous = Element("pous")
    for unit in units:
        _add_pou(pous, unit)
    ElementTree.indent(pous, " ")
    words = {
        "name": labels.prefix,
        "version": undeadzone.__version__,
        "hash": code.hash,
        "pous": ElementTree.tostring(pous, "unicode"),
    }
    return fill_template("templates/plcopen.xml", words)


def _add_pou(pous: Element, unit: PlcUnit) -> None:
    """Add a program organisation unit to the XML."""
    pou = SubElement(pous, "pou", name=unit.name, pouType=_KINDS[unit.keyword])
    interface = SubElement(pou, "interface")
    if unit.returns:
        SubElement(SubElement(interface, "returnType"), unit.returns)
    for section, variables in unit.variables.items():
        if variables:
            group = SubElement(interface, _SECTIONS[section])
            for variable in variables:
                _add_plc_variable(group, variable)
    _add_xhtml(interface, "documentation", _to_ascii_remark(unit.meaning))
    body = SubElement(pou, "body")
    _add_xhtml(body, "ST", "\n".join(unit.lines))


def _add_plc_variable(group: Element, variable: PlcVariable) -> None:
    """Add a variable to the XML."""
    declared = SubElement(group, "variable", name=variable.name)
    kind = SubElement(declared, "type")
    if variable.is_array:
        array = SubElement(kind, "array")
        SubElement(array, "dimension", lower="0", upper=str(len(variable.start) - 1))
        kind = SubElement(array, "baseType")
    name = variable.kind.rpartition(" ")[2]
    if name in (*TYPES.values(), "INT"):
        SubElement(kind, name)
    else:
        SubElement(kind, "derived", name=name)
    if variable.start:
        value = SubElement(declared, "initialValue")
        if variable.is_array:
            value = SubElement(value, "arrayValue")
        for text in variable.start:
            entry = SubElement(value, "value") if variable.is_array else value
            SubElement(entry, "simpleValue", value=text)
    if variable.meaning:
        _add_xhtml(declared, "documentation", _to_ascii_remark(variable.meaning))


def _add_xhtml(parent: Element, tag: str, text: str) -> None:
    """Add a text to the XML."""
    SubElement(SubElement(parent, tag), "xhtml", xmlns=_XHTML).text = text
