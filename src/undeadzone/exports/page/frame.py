"""The HTML around the data: its own script and style, and a policy that allows nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html import escape
from importlib.resources import files
from typing import Any

from undeadzone.support.text import printable

MARK = '<meta name="generator" content="undeadzone export">'


def framed(title: str, data: dict[str, Any]) -> str:
    """The page.

    Args:
        title: its title.
        data: what its script reads.
    """
    folder = files("undeadzone.exports.page")
    text, style, script = (
        (folder / f"page.{kind}").read_text(encoding="utf-8") for kind in ("html", "css", "js")
    )
    policy = (
        f"default-src 'none'; script-src {_digest(script)} 'wasm-unsafe-eval'; "
        f"style-src {_digest(style)}; img-src data:; base-uri 'none'; form-action 'none'"
    )
    content = json.dumps(data, separators=(",", ":"), allow_nan=False)
    parts = {
        "__POLICY__": policy,
        "__TITLE__": escape(printable(title)),
        "__STYLE__": style,
        "__SCRIPT__": script,
        "__DATA__": content.replace("<", "\\u003c"),
    }
    return re.sub("__[A-Z]+__", lambda mark: parts[mark[0]], text)


def _digest(text: str) -> str:
    """The hash by which the page's policy allows a text, and no other."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
