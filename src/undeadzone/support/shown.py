"""Results as people look at them: aligned text in a terminal, tables and a figure in a notebook.

A result is a list of blocks: text, pairs of name and value, or rows of cells whose first row is
the head.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, TypeAlias

from undeadzone.support.text import printable

Pairs: TypeAlias = Mapping[str, Any]
Rows: TypeAlias = Sequence[Sequence[str]]
Block: TypeAlias = str | Pairs | Rows

DOTS = 110  # per inch, of figures in a notebook


def text(blocks: Sequence[Block]) -> str:
    """Blocks as text, an empty line between them."""
    return "\n\n".join(map(_text, blocks))


def html(blocks: Sequence[Block]) -> str:
    """Blocks as HTML for a notebook; everything in them is escaped."""
    return "\n".join(map(_html, blocks))


def display(result: Any, blocks: Sequence[Block]) -> str:
    """A result as a notebook shows it: its blocks, and the figure that `uz.plot` draws of it.

    Args:
        result: what `uz.plot` takes.
        blocks: its numbers.
    """
    import undeadzone
    from undeadzone.errors import InputError

    shown = html(blocks)
    try:
        figure = undeadzone.plot(result)
    except InputError:  # nothing in it can be drawn
        return shown
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS)
    image = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'{shown}\n<img alt="figure" src="data:image/png;base64,{image}" width="100%">'


def aligned(pairs: Pairs) -> list[str]:
    """Lines `name  value`; a list takes a line for each of its entries."""
    width = max(len(printable(name)) for name in pairs)
    lines = []
    for name, value in pairs.items():
        head = printable(name)
        for entry in _entries(value):
            lines.append(printable(f"{head:<{width}}  {_cell(entry)}"))
            head = ""
    return lines


def columns(rows: Rows) -> list[str]:
    """Lines of aligned columns."""
    shown = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    lines = []
    for row in shown:
        cells = [f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())
    return lines


def _text(block: Block) -> str:
    """One block as text."""
    if isinstance(block, str):
        return printable(block)
    lines = aligned(block) if isinstance(block, Mapping) else columns(block)
    return "\n".join(lines)


def _html(block: Block) -> str:
    """One block as HTML."""
    if isinstance(block, str):
        return f"<p>{_escaped(block)}</p>"
    if isinstance(block, Mapping):
        rows = [_pair(name, value) for name, value in block.items()]
        return f"<table>{''.join(rows)}</table>"
    head = "".join(f"<th>{_escaped(cell)}</th>" for cell in block[0])
    body = "".join(f"<tr>{''.join(map(_td, row))}</tr>" for row in block[1:])
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _pair(name: str, value: Any) -> str:
    """A row of a table of pairs."""
    cell = "<br>".join(_escaped(_cell(entry)) for entry in _entries(value))
    style = ' style="text-align:left"'
    return f"<tr><th{style}>{_escaped(name)}</th><td{style}>{cell}</td></tr>"


def _td(cell: str) -> str:
    """A cell of a table of rows."""
    return f"<td>{_escaped(cell)}</td>"


def _entries(value: Any) -> list[Any]:
    """The lines of a value."""
    return value if isinstance(value, list) else [value]


def _cell(value: Any) -> str:
    """A value as text."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _escaped(words: str) -> str:
    """Text of others in HTML."""
    return escape(printable(words))
