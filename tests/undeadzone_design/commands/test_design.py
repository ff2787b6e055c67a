"""`undeadzone check` and `undeadzone design` as a user meets them, and what they draw."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from click import ClickException
from click.testing import CliRunner
from scipy.linalg import expm
from test_report import check_page

import once
import undeadzone
from documents import EXAMPLES
from scenes import COUPLED, PAPER, scene, tables_of
from undeadzone.analysis.certificate.design_file import Design, format_gains
from undeadzone.analysis.error_dynamics import branch_pattern
from undeadzone.cli import group
from undeadzone.errors import UndeadzoneError
from undeadzone.report.style import create_panels, figure_to_bytes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone_design.convergence.falsify import SwitchMode, error_generator
from undeadzone_design.convergence.trajectories import (
    Trajectory,
    simulate_trajectories,
    worst_settling_time,
)
from undeadzone_design.report.gain_figures import plot_ellipses, root_locus
from undeadzone_design.report.gains_page import draw_gain_figures, gains_page
from undeadzone_design.report.proof_figures import plot_courses as courses_figure
from undeadzone_design.report.proof_figures import plot_positive_realness
from undeadzone_design.synthesis.assessment import Assessment, assess_problem, attack_gains
from undeadzone_design.synthesis.check import check_assessment

POLES = {"method": "certified", "L": [12.0, 15.0], "gamma": 2.0}
QUIET = ("--json", "--no-figures")


class Done(NamedTuple):
    """What a command left: exit code, stdout, stderr (for an error of undeadzone its message)."""

    code: int
    out: str
    error: str

    @property
    def found(self) -> Any:
        return json.loads(self.out)


def run(*arguments: str | Path) -> Done:
    """A command in this process, so that nothing is imported twice; errors give exit code 2."""
    result = CliRunner().invoke(group, [*map(str, arguments)], standalone_mode=False)
    if isinstance(result.exception, UndeadzoneError | ClickException):
        return Done(
            2,
            result.stdout,
            result.exception.format_message()
            if isinstance(result.exception, ClickException)
            else str(result.exception),
        )
    if result.exception is not None:
        raise result.exception
    return Done(result.return_value, result.stdout, result.stderr)


def watched_by(observer: str) -> str:
    """The paper's scenario with one line in place of its table `observer`, which comes last."""
    return f"{PAPER.split('[observer]')[0]}{observer}\n"


@pytest.fixture(autouse=True, scope="module")
def designed_once() -> Iterator[None]:
    """What two tests design is designed once; `test_design_synthesis` designs again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(undeadzone, "design", once.design)
        yield


@pytest.fixture
def paper(tmp_path: Path) -> Callable[..., Path]:
    """A file of the paper's scenario with other words in place of some."""

    def written(**changes: str) -> Path:
        text = PAPER
        if "observer" in changes:
            text = watched_by(changes["observer"])
        for old, new in changes.items():
            lines = [new if line.startswith(f"{old} =") else line for line in text.splitlines()]
            text = "\n".join(lines)
        path = tmp_path / "scenario.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return written


def observed(L: list[float], gamma: float) -> str:
    return f'observer = {{ method = "certified", L = {L}, gamma = {gamma} }}'


@pytest.fixture(scope="module")
def knee(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """The default design of the paper's example, with everything that it writes."""
    folder = tmp_path_factory.mktemp("knee")
    (folder / "paper.toml").write_text(PAPER, encoding="utf-8")
    return folder, run("design", folder / "paper.toml", "--json", "--out", folder / "out")


# ---- check: verdicts


@pytest.mark.parametrize(
    ("L", "gamma", "code", "rate"),
    [([12.0, 15.0], 2.0, 1, 0.024), ([1.0, 1.5], 10.0, 0, 0.441), ([2.0, 3.0], 10.0, 0, 0.323)],
)
def test_check_on_the_paper_s_example(
    paper: Callable[..., Path], L: list[float], gamma: float, code: int, rate: float
) -> None:
    done = run("check", paper(observer=observed(L, gamma)), *QUIET)
    found = done.found
    assert (done.code, found["certified"]) == (code, code == 0)
    assert found["rate"] == pytest.approx(rate, abs=5e-4)
    assert found["identifiable"] == dict.fromkeys(("right", "left", "width", "centre"), True)
    assert (found["reasons"] == []) == (code == 0)


def test_check_says_where_the_certificate_fails_and_what_is_near(
    paper: Callable[..., Path],
) -> None:
    path = paper(observer=observed([12.0, 15.0], 2.0))
    found = run("check", path, *QUIET).found
    assert found["margin"] == pytest.approx(-1 / 24, abs=1e-9)
    assert found["frequency"] == pytest.approx(
        np.sqrt(6.2), abs=1e-6
    )  # minimum of Re(1 + G) = (w^4 - 10 w^2 + 40) / (1 + w^2)^2
    near = found["nearest"]
    assert near["margin"] >= 0.01
    b0, b1 = 1 + 2 * near["L"][0][0] + near["L"][1][0], 2 + near["L"][0][0]
    assert 2 * b1 > (np.sqrt(b0) - 1) ** 2
    printed = run("check", path, "--no-figures").out
    for words in (
        "NO: 1 + G is not positive real",
        "-0.04167 at 2.49 rad/s",
        "nearest certified",
        "0.02389 1/s",
    ):
        assert words in printed


def test_check_of_integrators_says_no_and_why() -> None:
    done = run("check", EXAMPLES / "integrators.toml", *QUIET)
    assert done.code == 1
    assert (done.found["certified"], done.found["nearest"]) == (False, None)
    assert done.found["identifiable"] == {
        "right": False,
        "left": False,
        "width": True,
        "centre": False,
    }
    assert "chain of integrators" in done.found["reasons"][0]
    assert "only the width" in done.found["reasons"][1]
    printed = run("check", EXAMPLES / "integrators.toml", "--no-figures").out
    assert "right NO, left NO, width yes, centre NO" in printed
    assert "centre[0]: these errors stay" in printed


def test_check_of_an_edge_never_reached_names_the_cure(paper: Callable[..., Path]) -> None:
    done = run(
        "check",
        paper(
            reference='reference = { kind = "sine", amplitude = 1.0, '
            "frequency = 1.0, offset = 0.5 }"
        ),
        *QUIET,
    )
    assert (done.code, done.found["certified"]) == (1, True)
    assert done.found["identifiable"]["right"]
    assert not done.found["identifiable"]["left"]
    assert "left edge is never reached" in done.found["reasons"][0]
    assert "reaches both edges" in done.found["cures"][0]


@pytest.mark.parametrize("method", ['"luenberger", L = [1.0, 1.5]', '"kalman", right = [0.2, 1.5]'])
def test_an_observer_without_constant_gains_needs_no_certificate(
    paper: Callable[..., Path], method: str
) -> None:
    path = paper(
        observer=f"observer = {{ method = {method} }}",
        simulation='simulation = { time = "sampled", step = 1e-2, duration = 2.0 }',
    )
    done = run("check", path, *QUIET)
    assert (done.code, done.found["certified"], done.found["rate"]) == (0, None, None)
    assert "no constant gains" in done.found["reasons"][0]


def test_check_of_two_outputs_gives_lists() -> None:
    done = run("check", EXAMPLES / "two_outputs.toml", *QUIET)
    assert done.code == 0
    assert [verdict["centre"] for verdict in done.found["identifiable"]] == [True, True]
    printed = run("check", EXAMPLES / "two_outputs.toml", "--no-figures").out
    assert re.search(r"identifiable +right.*\n0 +yes.*\n1 +yes", printed)


def test_check_writes_a_verdict_figures_and_a_page(
    paper: Callable[..., Path], tmp_path: Path
) -> None:
    out = tmp_path / "deep" / "out"
    done = run("check", paper(observer=observed([12.0, 15.0], 2.0)), "--json", "--out", out)
    assert sorted(path.name for path in out.iterdir()) == [
        "check.json",
        "ellipse.svg",
        "lyapunov.svg",
        "nyquist.svg",
        "report.html",
        "root_locus.svg",
    ]
    assert (
        json.loads((out / "check.json").read_text()) | {"files": done.found["files"]} == done.found
    )
    page = check_page((out / "report.html").read_text(encoding="utf-8"))
    assert page.tags.count("img") == 4
    assert "not certified" in page.text
    only = run("check", paper(), "--no-figures", "--json", "--out", tmp_path / "only")
    assert [Path(name).name for name in only.found["files"]] == ["check.json"]


def test_nothing_is_written_unless_requested(
    paper: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = paper()
    monkeypatch.chdir(path.parent)
    run("check", path, "--no-figures")
    run("design", path, "--maximise", "rate", "--no-figures")
    assert [found.name for found in path.parent.iterdir()] == [path.name]


# ---- design


def test_design_for_the_rate_alone(paper: Callable[..., Path]) -> None:
    done = run("design", paper(), "--maximise", "rate", *QUIET)
    found = done.found
    assert (done.code, found["certified"]) == (0, True)
    assert found["rate"] >= 1.45
    assert found["margin"] >= 0.01 * (1 - 1e-6)
    assert found["present"]["rate"] == pytest.approx(0.441, abs=5e-4)


def test_the_knee_beats_the_present_gains_in_everything(knee: tuple[Path, Done]) -> None:
    found = knee[1].found
    assert (knee[1].code, found["certified"], found["remarks"]) == (0, True, [])
    assert found["rate"] > found["present"]["rate"]
    assert found["disturbance"] < found["present"]["disturbance"]
    assert found["noise"] < found["present"]["noise"]
    assert len(found["front"]) > 20


def test_what_a_design_writes(knee: tuple[Path, Done]) -> None:
    folder, done = knee
    names = [
        "design.toml",
        "ellipse.svg",
        "front.svg",
        "lyapunov.svg",
        "nyquist.svg",
        "report.html",
        "root_locus.svg",
    ]
    assert sorted(path.name for path in (folder / "out").iterdir()) == names
    assert Design.load(folder / "out" / "design.toml").L.tolist() == done.found["L"]
    page = check_page((folder / "out" / "report.html").read_text(encoding="utf-8"))
    assert page.tags.count("img") == 5
    for words in (
        "What was asked",
        "The gains",
        "What is guaranteed",
        "How fast",
        "Identifiable widths",
        "mismatch",
        "eigenvalues of P, all positive",
    ):
        assert words in page.text


def test_run_and_check_use_a_design_and_refuse_a_forged_one(knee: tuple[Path, Done]) -> None:
    folder, done = knee
    observer = (
        'observer = { method = "certified", design = "out/design.toml", widths0 = [0.2, 0.2] }'
    )
    path = folder / "designed.toml"
    text = watched_by(observer).replace("duration = 2.0", "duration = 6.0")
    path.write_text(text, encoding="utf-8")
    assert run("check", path, *QUIET).found["rate"] == pytest.approx(done.found["rate"], rel=1e-9)
    result = run("run", path, *QUIET)
    assert (result.code, result.found["certified"]) == (0, True)
    assert result.found["largest_rise_of_V"] < 1e-12
    text = (folder / "out" / "design.toml").read_text(encoding="utf-8")
    first = str(tomllib.loads(text)["P"][0][0])
    (folder / "out" / "design.toml").write_text(
        text.replace(first, f"-{first}", 1), encoding="utf-8"
    )
    for command in ("run", "check", "design"):
        refused = run(command, path, *QUIET)
        assert (refused.code, refused.out) == (2, "")
        assert "proof does not hold" in refused.error
    (folder / "out" / "design.toml").write_text(text, encoding="utf-8")


def test_no_design_for_a_chain_of_integrators(tmp_path: Path) -> None:
    done = run("design", EXAMPLES / "integrators.toml", "--json", "--out", tmp_path / "out")
    assert (done.code, done.found["certified"], done.found["files"]) == (1, False, [])
    assert "chain of integrators" in done.found["reasons"][0]
    assert not (tmp_path / "out").exists()
    assert "NO gains" in run("design", EXAMPLES / "integrators.toml").out


def test_weights_make_another_trade(
    paper: Callable[..., Path], knee: tuple[Path, Done], monkeypatch: pytest.MonkeyPatch
) -> None:
    once.in_haste(monkeypatch)
    calm = run("design", paper(), "--weights", "0,0,1.5", *QUIET).found
    assert "noise^1.5" in calm["chosen"]

    def worth(point: dict[str, float]) -> float:
        return point["rate"] / point["noise"] ** 1.5

    assert worth(calm) > max(map(worth, knee[1].found["front"])) * (1 - 1e-3)


def test_design_in_words(paper: Callable[..., Path]) -> None:
    printed = run("design", paper(), "--maximise", "rate", "--margin", "0.3", "--no-figures").out
    for words in ("yes, margin 0.3 ", "proof P", "proof W", "yours 0.4406", "right yes, left yes"):
        assert words in printed


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--weights", "1,2"], "three numbers"),
        (["--weights", "1,2,-3"], "none negative"),
        (["--weights", "1,2,nan"], "none negative"),
        (["--weights", "a,b,c"], "three numbers"),
        (["--weights", "1,0,0", "--maximise", "rate"], "not both"),
        (["--maximise", "speed"], "speed"),
        (["--margin", "0"], "margin"),
        (["--margin", "1.5"], "margin"),
        (["--margin", "nan"], "margin"),
        (["--seed", "-1"], "-1"),
    ],
)
def test_wrong_options(paper: Callable[..., Path], options: list[str], words: str) -> None:
    done = run("design", paper(), *QUIET, *options)
    assert (done.code, done.out) == (2, "")
    assert words in done.error


@pytest.mark.parametrize(
    ("example", "words"), [("pendulum", "nonlinear"), ("jump_velocity", "jump")]
)
def test_no_design_where_there_is_no_method(example: str, words: str) -> None:
    done = run("design", EXAMPLES / f"{example}.toml", *QUIET)
    assert done.code == 2
    assert words in done.error


@pytest.mark.parametrize("command", ["check", "design"])
def test_help_teaches_by_an_example(command: str) -> None:
    printed = run(command, "--help").out
    assert f"Example: undeadzone {command} examples/" in printed
    assert "Exit code 1" in " ".join(printed.split())


def test_check_imports_no_more_than_it_needs(paper: Callable[..., Path], tmp_path: Path) -> None:
    """A kernel that lies in the cache would be linked: here there is none."""
    code = (
        "import sys\nfrom undeadzone.cli import group\n"
        f"arguments = ['check', {str(paper())!r}, '--no-figures', '--json']\n"
        "group.main(arguments, standalone_mode=False)\n"
        "heavy = 'llvmlite', 'matplotlib', 'rich', 'scipy.signal', 'pandas'\n"
        "print([m for m in heavy if m in sys.modules], file=sys.stderr)"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"UNDEADZONE_CACHE": str(tmp_path / "empty")},
        ).stderr
        == "[]\n"
    )


def test_a_wrong_scenario_is_no_answer(paper: Callable[..., Path]) -> None:
    path = paper(
        plant="plant = { A = [[-1.0, 0.0], [0.0, -2.0]], B = [[1.0], [1.0]], C = [[1.0, 0.0]] }"
    )
    for command in ("check", "design"):
        done = run(command, path, *QUIET)
        assert (done.code, done.out) == (2, "")
        assert "unobservable" in done.error


@pytest.mark.parametrize(
    ("gains", "text"),
    [
        ([[1.0], [1.5]], "[1, 1.5]"),
        ([2.0], "2"),
        ([2.0, 3.0], "[2, 3]"),
        ([[1.0, 2.0], [3.0, 4.0]], "[[1, 2], [3, 4]]"),
        ([[1.0]], "[1]"),
    ],
)
def test_gains_as_one_writes_them(gains: list[Any], text: str) -> None:
    assert format_gains(gains) == text


# ---- courses and figures

SAMPLED = {"simulation": {"time": "sampled", "step": 1e-2, "duration": 4.0}}
RIGHT = tables_of("""
sensor = { noise = 0.01 }
reference = { kind = "sine", amplitude = 1.0, frequency = 1.0, offset = 0.5 }
""")
JUMP = {"sensor": {"kind": "jump"}}


def counted(**changes: Any) -> Assessment:
    return assess_problem(resolve_scenario(scene(**changes)))


def by_kind(drawn: list[Trajectory]) -> dict[str, Trajectory]:
    return {course.kind: course for course in drawn}


@pytest.mark.parametrize("changes", [{}, SAMPLED, COUPLED, JUMP, COUPLED | SAMPLED])
def test_v_never_rises_on_any_course_of_certified_gains(changes: dict[str, Any]) -> None:
    of = counted(**changes)
    assert of.gains is not None
    tried = attack_gains(of)
    assert tried is not None
    assert not tried.attack.broken
    assert tried.cycle is None
    for course in tried.courses:
        assert np.diff(course.V).max() <= 1e-12
    found = by_kind(tried.courses)
    assert found["adversary"].V[-1] >= found["fair adversary"].V[-1]
    assert found["fair adversary"].V[-1] < 0.5


def test_the_reference_s_course_falls_at_the_rate() -> None:
    of = counted()
    assert of.gains is not None
    course = simulate_trajectories(of.gains.dynamics, of.gains.V, of.schedule, 30.0)[-1]
    late = [np.interp(t, course.t, course.V) for t in (20.0, 30.0)]
    assert np.log(late[0] / late[1]) / 20 == pytest.approx(of.gains.rates.rate, rel=1e-3)


def test_settling_is_the_first_pass_that_suffices() -> None:
    """Against the naive product of passes."""
    of = counted(**COUPLED)
    assert of.gains is not None
    given, V = of.gains.dynamics, of.gains.V
    once = np.eye(6)
    for sides, span in zip(of.schedule.sides, of.schedule.spans, strict=True):
        mode = SwitchMode(
            np.ones(1), branch_pattern(tuple(sides.astype(int))), np.ones(2), float(span)
        )
        once = expm(error_generator(given, mode) * span) @ once
    T = np.block([[np.linalg.cholesky(V.P).T, np.zeros((2, 4))], [np.zeros((4, 2)), np.sqrt(V.R)]])
    left, passes = once, 1
    while np.linalg.norm(T @ left @ np.linalg.inv(T), 2) > 0.01:
        left, passes = once @ left, passes + 1
    assert worst_settling_time(given, V, of.schedule) == pytest.approx(
        passes * of.schedule.total_duration
    )
    assert passes > 3


def test_an_attack_and_a_cycle_are_drawn_where_there_are_any() -> None:
    of = counted(observer=POLES)
    tried = attack_gains(of)
    assert of.gains is not None
    assert tried is not None
    assert by_kind(tried.courses)["attack"].V[-1] == pytest.approx(1 + tried.attack.rise, rel=1e-9)
    chain = counted(
        plant={"integrators": 2}, observer={"method": "certified", "L": [4.0, 4.0], "gamma": 1.0}
    )
    grown = attack_gains(chain)
    assert chain.gains is not None
    assert grown is not None
    assert grown.cycle is not None
    cycle = by_kind(grown.courses)["cycle"]
    once = np.interp([cycle.t[-1] - grown.cycle.seconds, cycle.t[-1]], cycle.t, cycle.V)
    assert once[1] / once[0] == pytest.approx(grown.cycle.factor**2, rel=0.02)
    titles = [axes.get_title(loc="left") for axes in courses_figure(chain.gains, grown).axes]
    assert any("cycle" in title for title in titles)


def test_nyquist_marks_the_worst_point_and_enlarges_it() -> None:
    of = counted(observer=POLES)
    assert of.gains is not None
    figure = plot_positive_realness(of.gains.certificate)
    assert len(figure.axes) == 3
    marked = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "o"]
    assert [float(np.asarray(line.get_xdata())[0]) for line in marked] == pytest.approx(
        [-1 / 24, -1 / 24, np.sqrt(6.2)]
    )
    assert len(plot_positive_realness(counted().gains.certificate).axes) == 2  # type: ignore[arg-type]
    assert len(plot_positive_realness(counted(**COUPLED).gains.certificate).axes) == 1  # type: ignore[arg-type]


@pytest.mark.parametrize("changes", [{}, SAMPLED])
def test_root_locus_goes_through_the_chosen_poles(changes: dict[str, Any]) -> None:
    of = counted(**changes)
    assert of.gains is not None
    for axes in root_locus(of, of.gains).axes[:2]:
        chosen = next(line for line in axes.lines if line.get_label() == "chosen")
        poles = np.asarray(chosen.get_xdata()) + 1j * np.asarray(chosen.get_ydata())
        A, L, gamma = of.gains.dynamics.A[0], of.gains.L, 10.0
        F = np.block([[A - L @ [[1.0, 0.0]], L], [np.array([[gamma, 0.0]]), np.array([[-gamma]])]])
        np.testing.assert_allclose(
            np.sort_complex(poles), np.sort_complex(np.linalg.eigvals(F)), atol=1e-9
        )


def test_ellipse_or_strip() -> None:
    noisy = counted(sensor={"noise": 0.01}, **SAMPLED)
    axes = plot_ellipses(noisy).axes[0]
    outline = next(line for line in axes.lines if line.get_label() == "95 %")
    assert np.max(outline.get_xdata()) == pytest.approx(
        2.447747 * noisy.known[0].std["right"], rel=1e-3
    )
    strip = plot_ellipses(counted(**RIGHT)).axes[0]
    assert "never reached" in strip.get_title(loc="left").replace("\n", " ")
    assert any("right ±" in str(line.get_label()) for line in strip.lines)
    nothing = plot_ellipses(
        counted(reference={"kind": "sine", "amplitude": 0.5, "frequency": 1.0})
    ).axes[0]
    assert any("only d_r > 0.5" in str(line.get_label()) for line in nothing.lines)


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        (COUPLED, ["nyquist", "root_locus", "lyapunov", "ellipse"]),
        (JUMP, ["nyquist", "root_locus", "lyapunov"]),
        (
            tables_of("""
                plant = { integrators = 2 }
                observer = { method = "certified", L = [4.0, 4.0], gamma = 1.0 }
                """),
            ["root_locus", "lyapunov", "ellipse"],
        ),
        ({"observer": {"method": "luenberger", "L": [1.0, 1.5]}}, ["ellipse"]),
    ],
)
def test_a_page_of_every_kind(changes: dict[str, Any], names: list[str]) -> None:
    of = counted(title="<b>&", **changes)
    tried = attack_gains(of)
    assert [*draw_gain_figures(of, tried)] == names
    blank = figure_to_bytes(create_panels([["a"]], "t")[0], "svg")
    page = check_page(gains_page(check_assessment(of), tried, dict.fromkeys(names, blank)))
    assert page.tags.count("img") == len(names)
    assert "<b>&" in page.text
