"""Figures and pages: complete, self-contained, escaped, and whole files or none."""

from __future__ import annotations

import dataclasses
import warnings
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest

from scenes import scene
from undeadzone.errors import FileError
from undeadzone.report.figures import overview, plot
from undeadzone.report.html import Html, html, page, paragraph, picture, run_page, section, table
from undeadzone.report.style import png, sheet, write
from undeadzone.simulation.run import Run
from undeadzone.simulation.simulate import simulate
from undeadzone.support.files import write_text

NASTY = '<script src="http://evil">alert("x")</script> & more'
VOID = {"meta", "img", "link", "br", "hr", "input"}


class Auditor(HTMLParser):
    """Collects tags, addresses and text, and checks that every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [
            value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")
        ]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(scene(title=NASTY), check_step=False)


@pytest.fixture(scope="module")
def two_outputs() -> Run:
    plant = {
        "A": [[-1.0, 0.2], [0.0, -2.0]],
        "B": [[1.0, 0.0], [0.0, 1.0]],
        "C": [[1.0, 0.0], [0.0, 1.0]],
    }
    observer = {"method": "certified", "gamma": 5.0}
    reference = {"kind": "sine", "amplitude": [3.0, 2.0], "frequency": 1.0}
    controller = {"method": "state_feedback", "poles": [-3.0, -4.0]}
    return simulate(
        scene(plant=plant, observer=observer, reference=reference, controller=controller),
        check_step=False,
    )


def check_page(text: str) -> Auditor:
    found = Auditor(text)
    assert all(address.startswith("data:image/png;base64,") for address in found.addresses)
    assert not {"script", "link", "iframe", "object"} & set(found.tags)
    assert "@import" not in text
    assert "url(" not in text
    return found


def test_a_run_s_page_is_self_contained_escaped_and_complete(run: Run) -> None:
    found = check_page(run_page(run, [overview(run)]))
    assert found.tags.count("img") == 1
    assert NASTY in found.text
    assert "diverged" in found.text


def test_a_page_without_figures(two_outputs: Run) -> None:
    found = check_page(run_page(two_outputs, []))
    assert "img" not in found.tags
    assert found.tags.count("table") == 2


def test_everything_that_is_not_html_is_escaped() -> None:
    found = check_page(
        page(
            NASTY,
            section(NASTY, paragraph(NASTY), table([NASTY], [[NASTY], [1.0], [None], [True]])),
            picture(png(sheet([["a"]], "t")[0]), NASTY),
        )
    )
    assert found.text.count(NASTY) == 7
    assert "script" not in found.tags


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Html("<b>"), "<b>"),
        (None, "&ndash;"),
        (True, "yes"),
        (0.1234567, "0.12346"),
        (12345678, "12345678"),
        ("a<b", "a&lt;b"),
    ],
)
def test_values_as_html(value: object, text: str) -> None:
    assert html(value) == text


def test_overview_has_a_panel_for_everything(run: Run, two_outputs: Run) -> None:
    assert len(overview(run).axes) == 4
    assert len(overview(two_outputs).axes) == 7
    assert len(overview(dataclasses.replace(two_outputs, V=None)).axes) == 6


def test_overview_shades_the_zone_and_labels_units(run: Run) -> None:
    units = msgspec.structs.replace(run.info.units, output="mm")
    figure = overview(dataclasses.replace(run, info=msgspec.structs.replace(run.info, units=units)))
    axes = figure.axes[0]
    labels = axes.get_legend_handles_labels()[1]
    assert {"dead zone", "reference r", "reading y", "output z"} <= set(labels)
    assert axes.get_ylabel() == "z, y [mm]"
    assert axes.patches[0].get_y() == -run.info.widths[1]
    assert figure.axes[1].get_yscale() == "log"


def test_a_diverged_run_is_drawn_up_to_where_it_did(run: Run) -> None:
    z = run.z.copy()
    z[900:] = np.geomspace(1.0, 1e300, z.shape[0] - 900)[:, None]
    z[-1] = np.nan
    lost = dataclasses.replace(run, x=np.hstack([z, z]), z=z, x_hat=np.hstack([z, z]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = overview(lost)
        png(figure)
    assert figure.axes[0].dataLim.y1 < 1e13
    assert "diverged at" in figure.axes[0].get_title(loc="left")


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_figures_are_written_whole(tmp_path: Path, suffix: str) -> None:
    path = write(sheet([["a"]], "t")[0], tmp_path / "deep" / f"figure{suffix}")
    assert path.stat().st_size > 1000
    assert [found.name for found in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["figure.bmp", "figure", "figure.exe"])
def test_an_unknown_suffix_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileError, match=r"\.png, \.pdf, \.svg"):
        write(sheet([["a"]], "t")[0], tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_an_unwritable_path_is_a_file_error(tmp_path: Path, run: Run) -> None:
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    with pytest.raises(FileError, match="cannot write"):
        write_text(page("t"), tmp_path / "file" / "page.html")
    with pytest.raises(FileError, match="cannot write"):
        plot(run, tmp_path / "file" / "figure.png")
