"""Display of results: aligned text in a terminal, tables and a figure in a notebook.

A result is a list of blocks: text, pairs of name and value, or rows of cells whose first row is
the head.
"""

from __future__ import annotations

import base64
import io
import os
import textwrap
from collections.abc import Mapping, Sequence
from html import escape
from itertools import starmap
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from undeadzone.errors import InputError
from undeadzone.util.installed import load_registered
from undeadzone.util.text import escape_controls

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Pairs: TypeAlias = Mapping[str, Any]
Rows: TypeAlias = Sequence[Sequence[str]]
Block: TypeAlias = str | Pairs | Rows

NARROWEST = 24  # characters of a value, however narrow the terminal
DOTS = 110  # per inch, of figures in a notebook


def format_blocks(blocks: Sequence[Block], width: int | None = None) -> str:
    """Return blocks as text, separated by empty lines.

    Args:
        blocks: blocks to show.
        width: characters that a line may have: longer ones are folded, and tables that are wider
            have a line for each cell (None: any).
    """
    return "\n\n".join("\n".join(_format_block(block, width)) for block in blocks)


def blocks_to_html(blocks: Sequence[Block]) -> str:
    """Return blocks as escaped HTML for a notebook."""
    return "\n".join(map(_block_to_html, blocks))


def source_to_html(words: str) -> str:
    """Return a text with its lines kept, such as a scenario, as HTML for a notebook."""
    lines = list(map(_escape_html, words.split("\n")))
    return f'<pre style="line-height:1.35">{chr(10).join(lines)}</pre>'


def plot(result: Any, path: str | os.PathLike[str] | None = None, ax: Axes | None = None) -> Figure:
    """Return the figure that `uz.plot` draws for a result (a method of every result).

    The function that draws is found by its entry point, as this package imports none above it.

    Args:
        result: what `uz.plot` takes.
        path: the file to write, a PNG, PDF or SVG by its suffix (None writes none).
        ax: axes that take the most informative panel (None: a new figure with all panels).
    """
    draw = load_registered("undeadzone.figures", "plot")
    return cast("Figure", draw(result, path, ax))


def format_result(result: Any) -> str:
    """Return the tables that a result's command prints (`__repr__` of results with `blocks`)."""
    return format_blocks(result.blocks())


def result_to_html(result: Any) -> str:
    """Return the tables and the figure of a result as HTML (`_repr_html_` of results with
    `blocks`).
    """
    tables = blocks_to_html(result.blocks())
    try:
        figure = plot(result)
    except InputError:  # nothing in it can be drawn
        return tables
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS)
    image = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'{tables}\n<img alt="figure" src="data:image/png;base64,{image}" width="100%">'


def _format_block(block: Block, width: int | None) -> list[str]:
    """Return a block as lines."""
    if isinstance(block, str):
        first, *others = _fold_line(escape_controls(block), width)
        return [first, *(f"  {line}" for line in others)]  # no line begins with words of others
    return (
        _align_lines(block, width) if isinstance(block, Mapping) else _align_columns(block, width)
    )


def _align_lines(pairs: Pairs, width: int | None) -> list[str]:
    """Return lines `name  value`. A list takes a line for each of its entries."""
    longest = max(len(escape_controls(name)) for name in pairs)
    lines = []
    for name, value in pairs.items():
        head = escape_controls(name)
        for entry in _value_entries(value):
            words = escape_controls(_format_cell(entry))
            room = None if width is None else max(width - longest - 2, NARROWEST)
            for part in _fold_line(words, room):
                lines.append(f"{head:<{longest}}  {part}".rstrip())
                head = ""
    return lines


def _align_columns(rows: Rows, width: int | None) -> list[str]:
    """Return lines of aligned columns, or a line for each cell if the table is too wide."""
    table = [list(map(escape_controls, row)) for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    if width is not None and sum(widths) + 2 * len(widths) - 2 > width:
        return _list_records(table, width)
    lines = []
    for row in table:
        cells = [f"{cell:<{size}}" for cell, size in zip(row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())
    return lines


def _list_records(rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return the rows of a table below each other, a line `head cell` for each filled cell."""
    heads, *others = rows
    lines: list[str] = []
    for row in others:
        cells = {head: cell for head, cell in zip(heads, row, strict=True) if cell}
        lines += [*([""] if lines else []), *_align_lines(cells, width)]
    return lines


def _fold_line(words: str, width: int | None) -> list[str]:
    """Return a line as lines of limited width. Longer words stay whole."""
    if width is None or len(words) <= width:
        return [words]
    return textwrap.wrap(words, width, break_long_words=False, break_on_hyphens=False)


def _block_to_html(block: Block) -> str:
    """Return a block as HTML."""
    if isinstance(block, str):
        return f"<p>{_escape_html(block)}</p>"
    if isinstance(block, Mapping):
        rows = list(starmap(_pair_to_html, block.items()))
        return f"<table>{''.join(rows)}</table>"
    head = "".join(f"<th>{_escape_html(cell)}</th>" for cell in block[0])
    body = "".join(f"<tr>{''.join(map(_cell_to_html, row))}</tr>" for row in block[1:])
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _pair_to_html(name: str, value: Any) -> str:
    """Return a row of a table of pairs as HTML."""
    cell = "<br>".join(_escape_html(_format_cell(entry)) for entry in _value_entries(value))
    style = ' style="text-align:left"'
    return f"<tr><th{style}>{_escape_html(name)}</th><td{style}>{cell}</td></tr>"


def _cell_to_html(cell: str) -> str:
    """Return a cell of a table of rows as HTML."""
    return f"<td>{_escape_html(cell)}</td>"


def _value_entries(value: Any) -> list[Any]:
    """Return the lines of a value."""
    return value if isinstance(value, list) else [value]


def _format_cell(value: Any) -> str:
    """Return a value as text."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _escape_html(words: str) -> str:
    """Return foreign text, escaped for HTML."""
    return escape(escape_controls(words))
