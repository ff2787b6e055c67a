"""Figures as files, and the same in a page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from undeadzone.report.html import Html, picture
from undeadzone.report.style import write

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_figures(drawn: Mapping[str, Figure], folder: Path) -> dict[str, Path]:
    """Write figures as SVG; their paths by name. Raises FileError.

    Args:
        drawn: figures by name.
        folder: where the files go; created if needed.
    """
    return {name: write(figure, folder / f"{name}.svg") for name, figure in drawn.items()}


def pictures(images: Mapping[str, bytes], captions: Mapping[str, str]) -> dict[str, Html]:
    """Figures (SVG) by name, each with its caption."""
    return {name: picture(image, captions[name]) for name, image in images.items()}


def images_of(written: Mapping[str, Path]) -> dict[str, bytes]:
    """What files hold, by name."""
    return {name: path.read_bytes() for name, path in written.items()}


def pick(shown: Mapping[str, Html], *names: str) -> list[Html]:
    """The pictures of these names that there are."""
    return [shown[name] for name in names if name in shown]
