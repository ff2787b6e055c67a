"""Figures and pages: complete, self-contained, escaped, and whole files or none."""

from __future__ import annotations

import dataclasses
import importlib
import re
import warnings
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure

import once
import undeadzone
from documents import raw_formulas
from scenes import scene, tables_of
from undeadzone.analysis.certificate.design_file import Design, Knowledge
from undeadzone.errors import FileError, InputError
from undeadzone.observers import Certified
from undeadzone.report.animation import (
    SIDEWAYS,
    TILT,
    _grid_spacing,
    _view_turn,
    visible_face_share,
)
from undeadzone.report.html import (
    MOST,
    Html,
    Origin,
    build_page,
    build_paragraph,
    build_section,
    build_table,
    encode_picture,
    format_html,
)
from undeadzone.report.plot import DRAWN, KINDS, plot
from undeadzone.report.run_figures import (
    constant_offset,
    joint_rows,
    layout_below,
    layout_beside,
    overview,
)
from undeadzone.report.run_page import run_page
from undeadzone.report.style import create_panels, figure_to_bytes, figure_to_png, write_figure
from undeadzone.results.run import Run
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import read
from undeadzone.simulation.simulate import simulate
from undeadzone.util.files import write_text
from undeadzone_arena.contest.figures import regret_cell_text, span_envelope
from undeadzone_design.report.gain_figures import ELLIPSE, _shade_strip, ellipse_border
from undeadzone_design.report.proof_figures import plot_positive_realness, recheck_design
from undeadzone_design.synthesis.assessment import assess_problem
from undeadzone_studies.ensemble.result import Ensemble
from undeadzone_studies.ensemble.run_ensemble import run_ensemble
from undeadzone_studies.report.ensemble_figures import bin_edges
from undeadzone_studies.report.ensemble_page import draw_ensemble_figures as ensemble_figures
from undeadzone_studies.report.tune_page import history
from undeadzone_studies.tuning.result import Tuned
from undeadzone_studies.tuning.tune import tune

NASTY = '<script src="http://evil">alert("x")</script> & more'
IMAGE = "data:image/svg+xml;base64,"
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
    plant = tables_of("""
        A = [[-1.0, 0.2], [0.0, -2.0]]
        B = [[1.0, 0.0], [0.0, 1.0]]
        C = [[1.0, 0.0], [0.0, 1.0]]
        """)
    observer = {"method": "certified", "gamma": 5.0}
    reference = {"kind": "sine", "amplitude": [3.0, 2.0], "frequency": 1.0}
    controller = {"method": "state_feedback", "poles": [-3.0, -4.0]}
    return simulate(
        scene(plant=plant, observer=observer, reference=reference, controller=controller),
        check_step=False,
    )


def check_page(text: str) -> Auditor:
    found = Auditor(text)
    assert all(address.startswith((IMAGE, "#")) for address in found.addresses)
    assert not {"script", "link", "iframe", "object"} & set(found.tags)
    assert "@import" not in text
    assert "url(" not in text
    return found


def test_a_run_s_page_is_self_contained_escaped_and_complete(run: Run) -> None:
    found = check_page(run_page(run, {"figure": figure_to_bytes(overview(run), "svg")}))
    assert found.tags.count("img") == 1
    assert NASTY in found.text
    assert "diverged" not in found.text  # a row that would say nothing is left out
    assert "–" not in re.sub(r"\[.*?\]", "", found.text.split("Symbols")[0])


def test_a_page_without_figures(two_outputs: Run) -> None:
    found = check_page(run_page(two_outputs, {}))
    assert "img" not in found.tags
    # first numbers, those by output, all; L, gamma, K, the same again, symbols
    assert found.tags.count("table") == 8


def test_a_page_answers_on_its_first_screen(run: Run) -> None:
    """A sentence, a table of at most six lines, a picture, in one row where there is room."""
    text = run_page(run, {"figure": figure_to_bytes(overview(run), "svg")})
    first = text[text.index("<h2") : text.index("<h2", text.index("<h2") + 1)]
    assert 1 < first.count("<tr>") <= 1 + MOST
    assert first.index("<table>") < first.index("<figure")
    assert first.count("<figure") == 1
    assert 'class="wide narrow"' in first


def test_tables_are_as_narrow_as_can_be_and_say_something_in_each_row() -> None:
    upright = build_table(
        ("output", "d_r", "d_l", "width", "centre"), [(0, 1.0, 2.0, 3.0, -1.0)]
    ).text
    assert upright.count("<tr>") == 1 + 5
    assert "narrow" in upright
    wide = build_table(
        ("output", "d_r", "d_l", "width", "centre"), [(0, 1.0, 2.0, 3.0, -1.0)] * 2
    ).text
    assert "narrow" not in wide
    assert wide.count("<tr>") == 1 + 2
    silent = build_table(("what", "value"), [("a", 1.0), ("b", None)]).text
    assert silent.count("<tr>") == 1 + 1


def test_a_section_without_contents_is_none() -> None:
    assert build_section("Over time").text == ""
    assert '<div class="parts">' in build_section("Over time", "words").text


def test_a_page_leads_to_its_sections_and_tells_how_to_repeat_it(run: Run) -> None:
    origin = Origin("undeadzone run 'a <b>.toml'", "# as given\n[plant]\n", 7)
    text = run_page(run, {"figure": figure_to_bytes(overview(run), "svg")}, origin=origin)
    found = check_page(text)
    anchors = [address[1:] for address in found.addresses if address.startswith("#")]
    assert anchors == re.findall(r'<h2 id="([^"]+)">', text)
    assert {"numbers", "gains", "the-same-again", "symbols"} <= set(anchors)
    for words in (origin.command, "# as given", undeadzone.__version__):
        assert words in found.text
    assert re.search(r"seed\s*7", found.text)
    for gain in run.info.gains["L"]:
        assert f"{gain[0]:.4g}" in found.text


def test_a_run_knows_how_to_repeat_itself(run: Run, tmp_path: Path) -> None:
    again = tmp_path / "again.toml"
    again.write_text(run.info.scenario, encoding="utf-8")
    np.testing.assert_array_equal(simulate(read(again), check_step=False).z, run.z)
    assert run.info.version == undeadzone.__version__
    own = simulate(
        scene(simulation=SAMPLED), controller=lambda t, estimate, r: 3.0 * (r - estimate.z)
    )
    assert own.info.scenario == ""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("z^ and x~", "z\u0302 and x\u0303"),
        ("d_r^ − d_l", "d\u0302<sub>r</sub> − d<sub>l</sub>"),
        ("c_l^ + b_r", "c\u0302<sub>l</sub> + b<sub>r</sub>"),
        ("m/s^2, d_right, z^2, A_d_r", "m/s^2, d_right, z^2, A_d_r"),
    ],
)
def test_symbols_are_those_of_the_figures(text: str, expected: str) -> None:
    assert format_html(text) == expected


def test_figures_on_a_page_stay_legible_on_a_phone(run: Run) -> None:
    page_of_run = run_page(run, {"figure": figure_to_bytes(overview(run), "svg")})
    least = re.search(r"min-width:(\d+)px", page_of_run)
    assert least is not None
    assert int(least[1]) == 720  # of 10 inches: three quarters of them


def test_the_same_figure_gives_the_same_svg(run: Run) -> None:
    assert figure_to_bytes(overview(run), "svg") == figure_to_bytes(overview(run), "svg")


def test_everything_that_is_not_html_is_escaped() -> None:
    found = check_page(
        build_page(
            NASTY,
            build_section(
                NASTY,
                build_paragraph(NASTY),
                build_table([NASTY], [[NASTY], [1.0], [None], [True]]),
            ),
            encode_picture(figure_to_bytes(create_panels([["a"]], "t")[0], "svg"), NASTY),
        )
    )
    assert found.text.count(NASTY) == 8  # once in the contents
    assert "script" not in found.tags


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Html("<b>"), "<b>"),
        (None, "&ndash;"),
        (True, "yes"),
        (0.1234567, "0.1235"),
        (12345678, "12345678"),
        ("a<b", "a&lt;b"),
    ],
)
def test_values_as_html(value: object, text: str) -> None:
    assert format_html(value) == text


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
        figure_to_png(figure)
    assert figure.axes[0].dataLim.y1 < 1e13
    assert "diverged at" in figure.axes[0].get_title(loc="left")


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_figures_are_written_whole(tmp_path: Path, suffix: str) -> None:
    path = write_figure(create_panels([["a"]], "t")[0], tmp_path / "deep" / f"figure{suffix}")
    assert path.stat().st_size > 1000
    assert [found.name for found in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["figure.bmp", "figure", "figure.exe"])
def test_an_unknown_suffix_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileError, match=r"\.png, \.pdf, \.svg"):
        write_figure(create_panels([["a"]], "t")[0], tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_an_unwritable_path_is_a_file_error(tmp_path: Path, run: Run) -> None:
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    with pytest.raises(FileError, match="cannot write"):
        write_text(build_page("t"), tmp_path / "file" / "page.html")
    with pytest.raises(FileError, match="cannot write"):
        plot(run, tmp_path / "file" / "figure.png")


# --- plot: any result


SAMPLED = {"time": "sampled", "step": 1e-2}


@pytest.fixture(scope="module")
def ensemble() -> Ensemble:
    vary = {"runs": 16, "sensor.right": {"uniform": [0.5, 1.5]}}
    return run_ensemble(scene(ensemble=vary, simulation=SAMPLED))


@pytest.fixture(scope="module")
def design() -> Design:
    return once.design(scene(), "rate")


@pytest.fixture(scope="module")
def tuned() -> Tuned:
    search = {"runs": 4, "held_out": 4, "budget": 4, "observer.gamma": {"between": [1.0, 20.0]}}
    return tune(scene(tune=search, simulation=SAMPLED))


def title(figure: Figure) -> str:
    return figure.get_suptitle()


@pytest.mark.parametrize(
    ("kind", "suffix"),
    [("run", ".png"), ("run", ".svg"), ("run", ".pdf"),
     ("ensemble", ".svg"), ("design", ".pdf"), ("tuned", ".png")],
)  # fmt: skip
def test_plot_writes_any_result(
    kind: str, suffix: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    path = tmp_path / f"figure{suffix}"
    figure = request.getfixturevalue(kind).plot(str(path))
    assert isinstance(figure, Figure)
    assert path.stat().st_size > 1000


@pytest.mark.parametrize("kind", ["run", "ensemble", "design", "tuned"])
def test_plot_without_a_path_returns_the_figure(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    figure = plot(request.getfixturevalue(kind))
    assert isinstance(figure, Figure)
    assert figure_to_png(figure).startswith(b"\x89PNG")
    assert not list(tmp_path.iterdir())


def test_plot_draws_what_the_report_shows_first(
    run: Run, ensemble: Ensemble, design: Design, tuned: Tuned
) -> None:
    assert title(plot(run)) == title(overview(run))
    first = next(iter(ensemble_figures(ensemble, ensemble.summary()).values()))
    assert figure_to_png(plot(ensemble)) == figure_to_png(first)
    observer = Certified(L=design.L, gamma=design.gamma, width_max=3.0)
    gains = assess_problem(
        resolve_scenario(msgspec.structs.replace(scene(), observer=observer))
    ).gains
    assert gains is not None
    assert title(plot(design)) == title(plot_positive_realness(gains.certificate))
    curves = [
        figure.axes[0].lines[-2].get_xydata()
        for figure in (plot(design), plot_positive_realness(gains.certificate))
    ]
    np.testing.assert_allclose(curves[0], curves[1], rtol=1e-9)
    assert figure_to_png(plot(tuned)) == figure_to_png(history(tuned))


def test_a_lost_ensemble_is_drawn_over_time_or_refused(ensemble: Ensemble) -> None:
    metrics = ensemble.metrics | {"diverged": np.ones(ensemble.info.runs)}
    lost = dataclasses.replace(ensemble, metrics=metrics)
    assert "over time" in title(plot(lost))
    with pytest.raises(InputError, match="every run of this ensemble diverged"):
        plot(dataclasses.replace(lost, bands=None))


@pytest.mark.parametrize("wrong", [None, "run.npz", 3.0, {"z": [1.0]}, np.zeros(3)])
def test_plot_of_anything_else_says_what_it_expects(wrong: Any, tmp_path: Path) -> None:
    expected = f"expected {KINDS}, found {type(wrong).__name__}"
    with pytest.raises(InputError, match=expected):
        plot(wrong, tmp_path / "figure.png")
    assert not list(tmp_path.iterdir())


def test_the_proof_of_a_design_holds(design: Design) -> None:
    proof = recheck_design(design)
    assert proof.certified
    assert proof.check.proved
    assert proof.margin == design.margin
    broken = msgspec.structs.replace(design, P=(-np.array(design.P)).tolist())
    assert not recheck_design(broken).certified


# --- The small parts of figures


def test_panels_of_a_run() -> None:
    assert layout_below(1, True) == [
        ["output 0"] * 6,
        ["error 0"] * 2 + ["widths 0"] * 2 + ["V"] * 2,
    ]
    assert layout_below(2, True)[3] == ["error 1"] * 3 + ["widths 1"] * 3
    assert layout_below(1, False)[1] == ["error 0"] * 3 + ["widths 0"] * 3
    rows = layout_beside(3, True)
    assert rows[0] == ["output 0"] * 6 + ["error 0"] * 3 + ["widths 0"] * 3
    assert rows[-1] == ["V"] * 12
    assert len(layout_beside(3, False)) == 3


@pytest.mark.parametrize(
    ("joints", "rows"),
    [
        (1, [["0"]]),
        (2, [["0", "1"]]),
        (4, [["0", "1", "2"], ["3", ".", "."]]),
        (6, [["0", "1", "2"], ["3", "4", "5"]]),
    ],
)
def test_panels_of_joints(joints: int, rows: list[list[str]]) -> None:
    assert joint_rows(joints) == rows


def test_an_offset_is_a_constant_difference() -> None:
    q = np.linspace(0.0, 1.0, 5)
    assert constant_offset(q + 0.25, q) == pytest.approx(0.25)
    assert constant_offset(q, 2 * q) is None


def test_bins_hold_all_values_on_the_scale_that_suits_them() -> None:
    even, decades, alike = np.linspace(1.0, 2.0, 1000), np.geomspace(1e-3, 1.0, 1000), np.ones(50)
    for values, logarithmic in ((even, False), (decades, True), (alike, False)):
        edges, found = bin_edges(values)
        assert found == logarithmic
        assert edges[0] <= values[0]
        assert values[-1] <= edges[-1]
        assert (np.diff(edges) > 0).all()


@pytest.mark.parametrize(
    ("value", "text"),
    [(np.nan, "–"), (12.3, "12"), (9.96, "10"), (1.23, "1.2"), (0.123, ".12"), (-0.123, "−.12")],
)
def test_regrets_in_three_places(value: float, text: str) -> None:
    assert regret_cell_text(value) == text


def test_an_envelope_lies_on_its_values() -> None:
    size = np.abs(np.sin(np.arange(1000.0)))
    assert (span_envelope(size) >= size).all()
    assert np.isinf(span_envelope(np.array([0.0, np.nan]), parts=1)).all()


def test_the_ellipse_holds_the_deviations() -> None:
    right, left, correlation = 0.3, 0.2, 0.5
    both = 2 * correlation * right * left
    std = {
        "right": right,
        "left": left,
        "width": float(np.sqrt(right**2 + left**2 + both)),
        "centre": float(np.sqrt(right**2 + left**2 - both)) / 2,
    }
    x, y = ellipse_border(std)
    reach = [np.abs(x).max(), np.abs(y).max(), np.abs(x + y).max(), np.abs(x - y).max() / 2]
    np.testing.assert_allclose(reach, ELLIPSE * np.array([*std.values()]), rtol=1e-3)


def test_an_arm_in_space_is_turned_until_its_path_shows_its_face_and_one_in_a_plane_is_not() -> (
    None
):
    """A circle in the plane y = 0.4, beside a base at 0."""
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    tip = np.column_stack([0.3 * np.cos(angle), 0.4 + 0 * angle, 0.3 * np.sin(angle)])
    arm: Any = SimpleNamespace(
        tip=tip, tip_r=tip, poses=np.zeros((1, 2, 3)), info=SimpleNamespace(step=1.0)
    )
    turn = _view_turn(arm)
    normal = np.array([0.0, 1.0, 0.0])
    shares = [visible_face_share(normal, side - np.pi / 2) for side in SIDEWAYS]
    assert visible_face_share(normal, turn) == pytest.approx(max(shares))
    arm.tip = tip[:, :2]
    assert _view_turn(arm) == 0.0


def test_a_face_turned_to_the_eye_is_seen_whole() -> None:
    eye = np.array([0.0, -np.cos(TILT), np.sin(TILT)])
    assert visible_face_share(eye, 0.0) == pytest.approx(1.0)
    assert visible_face_share(np.array([1.0, 0.0, 0.0]), 0.0) == pytest.approx(0.0)
    assert visible_face_share(np.array([1.0, 0.0, 0.0]), np.pi / 2) == pytest.approx(np.cos(TILT))


@pytest.mark.parametrize(
    ("title", "raw"),
    [
        ("y of d_r, 5 sin 2\u03c0t, costs $5", False),
        ("error $y_{}$", True),
        (r"error \hat{y}", True),
        ("x_{1}", True),
    ],
)
def test_titles_hold_no_raw_formulas(title: str, raw: bool) -> None:
    figure, panels = create_panels([["a"]], title)
    panels["a"].set_title(r"$\hat y$")  # is typeset
    panels["a"].set_yscale("log")
    image = figure_to_bytes(figure, "svg")
    assert bool(raw_formulas(figure, image)) == raw
    assert b"<!--" not in image
    assert f"<title>{title}</title>" in image.decode()


def test_every_kind_of_result_names_drawing_functions_that_exist() -> None:
    """`uz.plot` finds them by name, which no type checker follows."""
    from undeadzone_arena.contest.contest import Contest
    from undeadzone_identify.results.result import Identified, IdentifiedOutputs

    contest = Contest.drawn.fget(None)  # type: ignore[attr-defined]
    for module, *names in [*DRAWN.values(), Identified.drawn, IdentifiedOutputs.drawn, contest]:
        found = importlib.import_module(module, "undeadzone.report")
        assert [name for name in names if not callable(getattr(found, name, None))] == []


def test_a_grid_has_five_to_a_dozen_lines() -> None:
    for size in np.geomspace(0.01, 50.0, 60):
        assert 4.99 <= size / _grid_spacing(float(size)) <= 12.51


def test_a_strip_is_as_wide_as_the_deviation_says() -> None:
    std = {"right": 0.1, "left": 9.0, "width": 9.0, "centre": 9.0}
    known = Knowledge(
        right=True, left=False, width=False, centre=False, reasons=[], cures=[], std=std
    )
    axes = create_panels([["plane"]], "")[1]["plane"]
    _shade_strip(axes, known, np.array([1.0, 1.0]), np.zeros(2))
    assert [line.get_label() for line in axes.lines] == ["95 %: right \u00b1 0.2"]


def test_reasons_name_their_output_if_there_are_several(run: Run, two_outputs: Run) -> None:
    unknown = [one | {"reasons": ["not reached"]} for one in two_outputs.info.identifiable]
    info = msgspec.structs.replace(two_outputs.info, identifiable=unknown)
    text = run_page(dataclasses.replace(two_outputs, info=info), {})
    assert all(f"{name}: not reached" in text for name in two_outputs.outputs)
    assert f"{run.outputs[0]}: not reached" not in run_page(run, {})
