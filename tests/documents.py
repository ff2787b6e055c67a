"""Scripts of docs/, and the texts of a figure that a reader sees."""

from __future__ import annotations

import html
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
EXAMPLES = ROOT / "examples"


def script_of_docs(name: str) -> Any:
    """The module of a script in docs/, which is no package."""
    spec = spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TYPESET = re.compile(r"(?<!\\)\$.*?(?<!\\)\$")  # what Matplotlib shows as a formula
RAW = re.compile(r"\\|[_^]\{|\$[^$]*\$")  # what nobody should have to read


def raw_formulas(figure: Any, image: bytes) -> list[str]:
    """Texts of a figure, and of its file as SVG, in which a reader sees LaTeX.

    A dollar alone may come from a user's words.
    """
    from matplotlib.text import Text

    texts = [text.get_text() for text in figure.findobj(Text)]
    plain_texts = [TYPESET.sub("", text).replace(r"\$", "$") for text in texts]
    svg_texts = [html.unescape(text) for text in re.findall(r">([^<>]+)<", image.decode())]
    svg_texts += re.findall(r"<!--.*?-->", image.decode(), re.DOTALL)
    outside_of_style = [text for text in svg_texts if not text.startswith("*{")]
    return [text for text in (*plain_texts, *outside_of_style) if RAW.search(text)]
