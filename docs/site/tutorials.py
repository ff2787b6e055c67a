"""The tutorials: scripts in cells, run as notebooks, as pages and as notebooks to download.

`python docs/site/tutorials.py` writes docs/tutorials/*.ipynb, which have no outputs.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

NAMES = (
    "own_plant",
    "log_to_widths",
    "design_with_proof",
    "your_robot",
    "arm_with_backlash",
    "to_a_board",
    "add_an_observer",
    "reproduce_the_paper",
)
LIMIT = 300  # seconds for one cell


def pages(folder: Path) -> dict[str, str | bytes]:
    """Page, notebook and figures of each tutorial, by file name.

    Args:
        folder: of the scripts.
    """
    made: dict[str, str | bytes] = {}
    for name in NAMES:
        notebook = executed(folder / f"{name}.py")
        made[f"{name}.ipynb"] = nbformat.writes(notebook)
        text, resources = MarkdownExporter().from_notebook_node(notebook)
        for output, content in resources["outputs"].items():
            text = text.replace(f"({output})", f"({name}_{output})")
            made[f"{name}_{output}"] = content
        download = f"[This page as a notebook]({name}.ipynb)\n"
        made[f"{name}.md"] = f"{text.rstrip()}\n\n{download}"
    return made


def read_cells(script: Path) -> nbformat.NotebookNode:
    """Return a script in cells as a notebook."""
    notebook = jupytext.read(script, fmt="py:percent")
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.metadata = nbformat.from_dict({"kernelspec": kernel})
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
    return notebook


def executed(script: Path) -> nbformat.NotebookNode:
    """A script in cells, run as a notebook in an empty folder."""
    notebook = read_cells(script)
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder)
        os.symlink(script.parents[2] / "examples", there / "examples")
        client = NotebookClient(notebook, timeout=LIMIT, resources={"metadata": {"path": folder}})
        client.execute()
    return notebook


if __name__ == "__main__":
    for each in sorted((Path(__file__).parents[1] / "tutorials").glob("*.py")):
        text = nbformat.writes(read_cells(each)) + "\n"
        each.with_suffix(".ipynb").write_text(text, encoding="utf-8")
