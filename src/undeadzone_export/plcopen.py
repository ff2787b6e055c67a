"""Units of Structured Text as files: as text, and as XML of PLCopen (TC6, version 2.01)."""

from __future__ import annotations

import itertools
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import undeadzone
from undeadzone.compile.print_c import wrap_statement
from undeadzone.compile.print_st import TYPES
from undeadzone.util.text import one_line
from undeadzone_export.code import Code
from undeadzone_export.plc import Unit, Variable
from undeadzone_export.source import Labels
from undeadzone_export.template import fill_template

_XHTML: Final = "http://www.w3.org/1999/xhtml"
_SECTIONS: Final = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
_KINDS: Final = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


def text_of(units: list[Unit], labels: Labels, code: Code) -> str:
    """Return the text of a file.

    Args:
        units: what it holds.
        labels: the words that the files share.
        code: what is printed.
    """
    head = [
        f"{labels.prefix}: {labels.part}, {TYPES[code.kind]}; hash {code.hash}.",
        f"Written by undeadzone {undeadzone.__version__}; do not edit.",
        "SPDX-License-Identifier: BSD-3-Clause",
    ]
    lines = [_remark("\n   ".join(head))]
    for unit in units:
        lines += ["", _remark(_plain(unit.meaning)), *_unit(unit)]
    return "\n".join([*lines, ""])


def _unit(unit: Unit) -> list[str]:
    """Return the lines of a unit."""
    returned = f" : {unit.returns}" if unit.returns else ""
    lines = [f"{unit.keyword} {unit.name}{returned}"]
    for section, variables in unit.variables.items():
        if variables:
            alike = itertools.groupby(variables, _declare_entry)
            declared = [_declaration(list(group), text) for text, group in alike]
            lines += [section, *itertools.chain(*declared), "END_VAR"]
    return [*lines, *unit.lines, f"END_{unit.keyword}"]


def _declare_entry(variable: Variable) -> tuple[str, str]:
    """Return type and value at first of a variable, and its meaning as a comment."""
    start = ", ".join(variable.start)
    given = f" := [{start}]" if variable.is_array else f" := {start}"
    remark = f" {_remark(_plain(variable.meaning))}" if variable.meaning else ""
    return f"{variable.kind}{given if variable.start else ''};", remark


def _declaration(variables: list[Variable], declared: tuple[str, str]) -> list[str]:
    """Return the lines of a declaration of variables that differ by their names."""
    kind, remark = declared
    *lines, last = wrap_statement(f"{', '.join(each.name for each in variables)} : {kind}")
    return [*lines, last + remark]


def _plain(text: str) -> str:
    """Return a text that may stand in a comment, which nothing in it ends; ASCII, as editors are
    old.
    """
    line = one_line(text).encode("ascii", "replace").decode()
    return line.replace("*)", "* )").replace("(*", "( *")


def _remark(text: str) -> str:
    """Return a comment."""
    return f"(* {text} *)"


# --- As XML


def xml_of(units: list[Unit], labels: Labels, code: Code) -> str:
    """Return the text of a file that development systems import.

    Args:
        units: what it holds.
        labels: the words that the files share.
        code: what is printed.
    """
    pous = Element("pous")
    for unit in units:
        _pou(pous, unit)
    ElementTree.indent(pous, " ")
    words = {
        "name": labels.prefix,
        "version": undeadzone.__version__,
        "hash": code.hash,
        "pous": ElementTree.tostring(pous, "unicode"),
    }
    return fill_template("templates/plcopen.xml", words)


def _pou(pous: Element, unit: Unit) -> None:
    """Add a unit."""
    pou = SubElement(pous, "pou", name=unit.name, pouType=_KINDS[unit.keyword])
    interface = SubElement(pou, "interface")
    if unit.returns:
        SubElement(SubElement(interface, "returnType"), unit.returns)
    for section, variables in unit.variables.items():
        if variables:
            group = SubElement(interface, _SECTIONS[section])
            for variable in variables:
                _variable(group, variable)
    _words(interface, "documentation", _plain(unit.meaning))
    body = SubElement(pou, "body")
    _words(body, "ST", "\n".join(unit.lines))


def _variable(group: Element, variable: Variable) -> None:
    """Add a variable."""
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
        _words(declared, "documentation", _plain(variable.meaning))


def _words(parent: Element, tag: str, text: str) -> None:
    """Add a text."""
    SubElement(SubElement(parent, tag), "xhtml", xmlns=_XHTML).text = text
