"""The page: its numbers are those of a run, its link holds all sliders, it asks for nothing."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from test_engines import PENDULUM, TWO_OUTPUTS, small
from test_lower import A, B, calling_outputs, stateless

import undeadzone as uz
from browser import Browser, browser
from documents import ROOT
from requirements import require
from scenes import scene, tables_of
from undeadzone.compile import print_wasm
from undeadzone.compile.lower import build_portable_nodes
from undeadzone.compile.numpy_reference import elementary_functions
from undeadzone.compile.repeats import outline_parts, outline_repeats
from undeadzone.errors import FileError, InputError
from undeadzone.report import html
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_export import accuracy, exported_step
from undeadzone_export.code import build_code
from undeadzone_export.page.build import build_live_page

LIVE = ROOT / "examples" / "live.toml"
SHIPPED = ROOT / "docs" / "live.html"
LARGEST = 60_000  # bytes of the shipped page
CLOSE = 1e-12  # of the page's signals and a run's, relative to each signal's size
SAMPLED = {"time": "sampled", "duration": 1.5, "step": 2e-3}
TWO = tables_of("""
plant.A = [[0.0, 1.0, 0.0, 0.0], [-3.0, -2.0, 1.0, 0.0], [0, 0, 0, 1], [1.0, 0.0, -4.0, -2.0]]
plant.B = [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]
plant.C = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
plant.x0 = [0.3, 0.0, -0.2, 0.0]
sensor = { right = [0.4, 0.2], left = [0.1, 0.3] }
observer = { method = "certified", gamma = [5.0, 3.0] }
controller = { method = "state_feedback", poles = [-5.0, -6.0, -7.0, -8.0] }
""")
CASES: dict[str, dict[str, Any]] = {
    "paper, sampled": {"simulation": SAMPLED},
    "paper, continuous": {"simulation": {"duration": 1.5, "step": 2e-3}},
    "plain switching": {"simulation": {"duration": 1.0, "step": 2e-3, "switching": "plain"}},
    "trapezoid and disturbance": (tables_of("""
        reference = { kind = "trapezoid", amplitude = 3.0, rise = 0.17, hold = 0.11 }
        disturbance = { kind = "sine", amplitude = 2.0, frequency = 0.7, offset = 1.0 }
        """) | {"simulation": SAMPLED}),
    "two sines about an offset": tables_of("""
        simulation = { duration = 1.0, step = 0.002 }
        reference.kind = "sines"
        reference.components = [
            { amplitude = 3.0, frequency = 1.0, phase = 0.4 },
            { amplitude = 1.0, frequency = 2.3 },
        ]
        reference.offset = 0.5
        """),
    "a filter": tables_of("""
        simulation = { time = "sampled", duration = 0.6, step = 0.005 }
        observer = { method = "kalman", right = [0.0, 2.0] }
        sensor = { threshold = 0.0 }
        """),
    "jump sensor, step": (tables_of("""
        sensor = { kind = "jump", slope = 2.0, quantum = 0.01 }
        reference = { kind = "step", amplitude = 3.0, time = 0.5, before = -1.0 }
        """) | {"simulation": SAMPLED}),
    "play, random disturbance": (tables_of("""
        plant = { A = [[0.0, 1.0], [0.0, -10.0]], B = [[0.0], [100.0]], C = [[1.0, 0.0]] }
        sensor = { kind = "play", right = 0.06, left = 0.04, quantum = 0.003 }
        observer = { method = "kalman", right = [0.0, 0.2], disturbance = 0.05 }
        controller = { method = "state_feedback", poles = [-20.0, -21.0] }
        reference = { kind = "sine", amplitude = 0.5, frequency = 1.0 }
        disturbance = { kind = "random", rms = 0.05, correlation_time = 0.1 }
        """) | {"simulation": SAMPLED}),
    "random disturbance in continuous time": tables_of("""
        disturbance = { kind = "random", rms = 1.0, correlation_time = 0.1 }
        simulation = { duration = 1.0, step = 0.002 }
        """),
    "pendulum": (tables_of("""
        observer = { method = "certified", L = [1.0, 0.0], widths0 = [0.2, 0.2] }
        controller = { method = "state_feedback", poles = [-4.0, -5.0] }
        sensor = { right = 0.2, left = 0.1 }
        reference = { kind = "sine", amplitude = 1.0, frequency = 0.5 }
        simulation = { duration = 2.0, step = 0.005 }
        """) | {"plant": PENDULUM}),
    "two outputs": TWO | {
        "reference": {"kind": "sine", "amplitude": [1.0, 0.5], "frequency": 0.9},
        "simulation": SAMPLED,
    },
}  # fmt: skip


BANK: dict[str, Any] = tables_of("""
simulation = { time = "sampled", duration = 0.6, step = 0.005 }
sensor = { noise = 0.02 }
observer = { method = "censored", right = [0.0, 2.0] }
""")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    require("browser", [] if browser() else ["chromium"])
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def open_page(page: Browser, scenario: Scenario, folder: Path, link: str = "") -> None:
    """Open the page of a scenario."""
    file = folder / "page.html"
    file.write_text(build_live_page(scenario).text, encoding="utf-8")
    page.open(file.as_uri() + link)


def largest_gap(page: Browser, run: uz.Run) -> float:
    """The largest difference of the page's signals and a run's, relative to each one's size."""
    gaps = []
    for output in range(run.z.shape[1]):
        page.value(f"shown = {output}; window.kept = run(); 0")
        signals = {
            "z": run.z[:, output],
            "y": run.y[:, output],
            "side": run.side[:, output],
            "z_hat": run.z_hat[:, output],
            "right": run.d_hat[:, 2 * output],
            "left": run.d_hat[:, 2 * output + 1],
        }
        if run.d_std is not None:
            signals["right_std"] = run.d_std[:, 2 * output]
        for name, expected in signals.items():
            values = np.array(page.value(f"Array.from(kept.{name})"), float)
            assert values.shape == expected.shape
            gaps.append(np.abs(values - expected).max() / (np.abs(expected).max() + 1e-300))
    return float(max(gaps))


@pytest.mark.parametrize("name", CASES)
def test_its_signals_are_those_of_a_run(name: str, page: Browser, tmp_path: Path) -> None:
    scenario = scene(**CASES[name])
    open_page(page, scenario, tmp_path)
    bar = 1e-10 if name == "a filter" else CLOSE  # a covariance magnifies rounding
    assert largest_gap(page, uz.simulate(scenario, check_step=False)) < bar
    assert not page.console


def test_a_wrong_sign_in_the_code_shows(
    page: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(print_wasm._TABLES["float64"], "sub", 0xA0)
    scenario = scene(simulation=SAMPLED)
    open_page(page, scenario, tmp_path)
    assert not largest_gap(page, uz.simulate(scenario)) <= 0.1  # it may diverge


def test_a_slider_changes_what_its_key_changes(page: Browser, tmp_path: Path) -> None:
    for simulation in (SAMPLED, {"duration": 1.0, "step": 2e-3}):
        link = "#right=0.7&left=0.45&size=3.3&speed=1.3&gamma=6.5&drive=12"
        open_page(page, scene(simulation=simulation), tmp_path, link)
        paper = scene().plant
        changed = scene(
            """
            sensor = { right = 0.7, left = 0.45 }
            reference = { kind = "sine", amplitude = 3.3, frequency = 1.3 }
            observer.method = "certified"
            observer.L = [1.0, 1.5]
            observer.gamma = 6.5
            observer.widths0 = [0.2, 0.2]
            observer.width_max = 3.0
            """,
            simulation=simulation,
            plant={"A": paper.A, "B": 1.12 * np.asarray(paper.B), "C": paper.C, "x0": paper.x0},
            model={"B": np.asarray(paper.B).tolist()},
        )
        assert largest_gap(page, uz.simulate(changed, check_step=False)) < CLOSE


def test_the_noise_slider_moves_threshold_and_belief(page: Browser, tmp_path: Path) -> None:
    for observer in ({"method": "certified"}, {"method": "kalman", "right": [0.0, 2.0]}):
        scenario = scene(simulation=SAMPLED, observer=observer, sensor={"noise": 0.05})
        noisier = scene(simulation=SAMPLED, observer=observer, sensor={"noise": 0.13})
        open_page(page, scenario, tmp_path, "#noise=0.13")
        moved = page.value("params()")
        open_page(page, noisier, tmp_path)
        assert moved == pytest.approx(page.value("D.params"), rel=1e-9, abs=1e-15)


def test_numbers_and_sentence_of_the_shipped_page(page: Browser) -> None:
    page.open(SHIPPED.as_uri())
    run = uz.simulate(uz.read(LIVE))
    half = slice(len(run.t) // 2, None)
    numbers = json.loads(page.value("document.documentElement.dataset.numbers"))
    errors = {"sensor": run.y - run.z, "observer": run.z_hat - run.z}
    for name, error in errors.items():
        assert numbers[name] == pytest.approx(float(np.sqrt(np.mean(error[half] ** 2))), rel=1e-10)
    assert numbers["silent"] == pytest.approx(float((run.side[half] == 0).mean()))
    assert [numbers["right"], numbers["left"]] == pytest.approx(run.d_hat[-1], rel=1e-12)
    sentence = page.value("document.getElementById('say').textContent")
    assert sentence == (
        "Silent 16 % of the time. Believing the sensor is wrong by 0.79; "
        "the observer, by 0.0052: 151 times better."
    )


def test_it_asks_for_nothing_and_says_nothing(page: Browser) -> None:
    page.open(SHIPPED.as_uri())
    page.sized(390, 844, dark=True)
    page.value("$('learn').click(); $('again').click(); $('share').click(); 0")
    page.value("new Promise(r => setTimeout(r, 700))")
    assert page.requests == [SHIPPED.as_uri()]
    assert page.console == []
    assert page.value("document.documentElement.scrollWidth <= innerWidth")
    assert page.value("[...document.querySelectorAll('input')].every(i => i.labels.length)")


def test_a_motion_inside_the_band_teaches_nothing(page: Browser) -> None:
    page.open(SHIPPED.as_uri() + "#size=0.5&right=1.5&left=1.5")
    assert "nothing can be learnt" in page.value("$('say').textContent")
    page.open(SHIPPED.as_uri() + "#size=1.2&right=0.5&left=3")
    assert "never passes the left edge" in page.value("$('say').textContent")
    page.open(SHIPPED.as_uri() + "#learn=0")
    assert "Learning is off" in page.value("$('say').textContent")
    assert page.value("last.m.right") == 0


def test_the_link_holds_every_slider(page: Browser) -> None:
    page.open(SHIPPED.as_uri())
    page.value(
        "for (const s of D.sliders) { const i = $('i_' + s.key); i.stepUp(3); "
        "i.dispatchEvent(new Event('input')); } $('learn').click(); 0"
    )
    page.value("new Promise(r => setTimeout(r, 900))")
    address, values = page.value("[location.href, v]")
    assert "learn=0" in address
    page.open(address)
    assert page.value("[v, learn]") == [values, False]


@pytest.mark.parametrize(
    "link",
    [
        "#gamma=<script>window.bad=1</script>&right=NaN&left=1e999&size=-1e999&speed=&noise=0x",
        "#gamma=%3Cimg%20src%3Dx%20onerror%3Dwindow.bad%3D1%3E&learn=%00&output=9&right=Infinity",
        "#__proto__=1&constructor=2&toString=3&look=7",
        "#" + "right=5&" * 5000,
        "#%E0%A4%A",
    ],
    ids=range(5),
)
def test_hostile_links_do_nothing(link: str, page: Browser) -> None:
    page.open(SHIPPED.as_uri() + link)
    sliders = page.value("D.sliders")
    values = page.value("v")
    assert sorted(values) == sorted(slider["key"] for slider in sliders)
    for slider in sliders:
        assert slider["least"] <= values[slider["key"]] <= slider["most"]
    assert page.value("[typeof bad, shown, learn]") == ["undefined", 0, True]
    assert page.console == []
    assert "Silent" in page.value("$('say').textContent")


def test_titles_and_units_of_strangers_are_text(page: Browser, tmp_path: Path) -> None:
    evil = "</script></title><script>window.bad=1</script><img src=x onerror=window.bad=1>\x1b[2J"
    scenario = scene(simulation=SAMPLED, title=evil, units={"output": evil})
    open_page(page, scenario, tmp_path)
    assert page.value("[typeof bad, document.images.length]") == ["undefined", 0]
    assert "onerror" in page.value("document.title")
    assert page.console == []


def test_elementary_functions_have_the_bits_of_the_replica(page: Browser) -> None:
    one = "exp expm1 log log1p erf sin cos tan atan asin acos sinh cosh tanh asinh acosh atanh"
    names = [*f"{one} fabs floor ceil sign".split(), "atan2", "pow", "hypot", "fmin", "fmax"]
    s, w, p = ca.SX.sym("s", 0), ca.SX.sym("w", 2), ca.SX.sym("p", 0)
    values = [_applied(name, w) for name in names]
    function = ca.Function("f", [s, w, p], [ca.vertcat(*values)], ["s", "w", "p"], ["o"])
    nodes = build_portable_nodes(function, "float64")
    places = [[16 + 8 * k for k in range(len(names))]]
    code = print_wasm.build_module(
        [print_wasm.Function("f", nodes, {"w0": 0, "w1": 8}, places)], 4096
    )
    rng = np.random.default_rng(0)
    points = np.vstack([rng.normal(size=(150, 2)) * size for size in (1e-3, 0.3, 2.0, 50.0, 700.0)])
    edges = [0.0, -0.0, 1.0, -1.0, 2.0, 1e300, 1e-310, np.inf, -np.inf, np.nan]
    points = np.vstack([points, [[a, b] for a in edges for b in edges]])
    found = _computed(page, code, points, len(names))
    functions = elementary_functions("float64") | {"fabs": np.abs}
    with np.errstate(all="ignore"):
        for k, name in enumerate(names):
            arguments = points.T if k >= len(names) - 5 else points.T[:1]
            expected = np.array([functions[name](*each) for each in zip(*arguments, strict=True)])
            np.testing.assert_array_equal(found[:, k], expected, name)


def _applied(name: str, w: ca.SX) -> ca.SX:
    """A function of the first entry, or of both."""
    two = {"atan2": ca.atan2, "pow": ca.power, "hypot": ca.hypot, "fmin": ca.fmin, "fmax": ca.fmax}
    return two[name](w[0], w[1]) if name in two else getattr(ca, name)(w[0])


def _computed(
    page: Browser, code: bytes, points: Floats, count: int, state: Floats | None = None
) -> Floats:
    """What a module with a function f makes of points, bit by bit.

    Its memory: an entry of each input, the results, the state.
    """
    memory = b"" if state is None else state.tobytes()
    text, given, start = (base64.b64encode(x).decode() for x in (code, points.tobytes(), memory))
    width = points.shape[1]
    page.value("document.title")
    result = page.value(
        f"""(async () => {{
        const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
        const {{ instance }} = await WebAssembly.instantiate(bytes("{text}"));
        const P = new Float64Array(bytes("{given}").buffer);
        const M = new Float64Array(instance.exports.memory.buffer);
        const O = new Float64Array(P.length / {width} * {count});
        M.set(new Float64Array(bytes("{start}").buffer), {width + count});
        for (let k = 0; k < P.length / {width}; k++) {{
            M.set(P.subarray({width} * k, {width} * (k + 1))); instance.exports.f();
            O.set(M.subarray({width}, {width + count}), k * {count});
        }}
        let all = ""; for (const b of new Uint8Array(O.buffer)) all += String.fromCharCode(b);
        return btoa(all); }})()"""
    )
    return np.frombuffer(base64.b64decode(result)).reshape(len(points), count)


@pytest.mark.parametrize("kind", ["found in the list of nodes", "calls of the trace"])
def test_repeated_parts_are_functions_with_the_bits_of_exported_c(
    kind: str, page: Browser, tmp_path: Path
) -> None:
    """The results of a step overwrite its state."""
    if kind == "calls of the trace":
        step = stateless([A, B], calling_outputs())
    else:
        step = exported_step.build_step(resolve_scenario(scene(**BANK)))
    printed = build_code(step, False)
    assert bool(printed.parts) == (kind == "calls of the trace")
    counts = [step.function.size1_in(1), step.function.size1_out(1), step.start.size]
    w, out, s = np.split(8 * np.arange(sum(counts)), np.cumsum(counts)[:-1])
    inputs = exported_step.name_entries(w=w.tolist(), s=s.tolist())
    targets = [s.tolist(), out.tolist()]
    inlined = build_portable_nodes(step.function, "float64")
    plain = print_wasm.build_module([print_wasm.Function("f", inlined, inputs, targets)], 4096)
    repeats = outline_parts(printed.parts)
    results = outline_repeats(printed.results, repeats)
    function = print_wasm.Function("f", results, inputs, targets)
    code = print_wasm.build_module([function], 4096, repeats)
    assert printed.parts or len(code) < 0.7 * len(plain)
    rows = np.random.default_rng(2).normal(size=(300, len(w))) * 3
    rows[::7, 0] = np.nan
    found = _computed(page, code, rows, len(out), step.start)
    np.testing.assert_array_equal(found, accuracy.CompiledStep(printed, tmp_path)(rows))


def test_a_large_expression_stays_shallow(page: Browser) -> None:
    w = ca.SX.sym("w", 2)
    total = w[0]
    for k in range(800):
        total = ca.if_else(total > k, total * 1.0001, total + w[1] * k)
    nodes = build_portable_nodes(ca.Function("f", [w], [total], ["w"], ["o"]), "float64")
    code = print_wasm.build_module(
        [print_wasm.Function("f", nodes, {"w0": 0, "w1": 8}, [[16]])], 64
    )
    expected = float(ca.Function("f", [w], [total])([1.0, 1e-3]))
    assert _computed(page, code, np.array([[1.0, 1e-3]]), 1)[0, 0] == expected


# --- Without a browser


def parts(text: str) -> tuple[str, dict[str, Any]]:
    """A page without its data, and the data."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    assert found is not None
    return text.replace(found[1], ""), json.loads(found[1])


def test_the_shipped_page_is_the_one_that_the_command_makes() -> None:
    rebuilt, shipped = build_live_page(uz.read(LIVE)).text, SHIPPED.read_text(encoding="utf-8")
    (frame, data), (old_frame, old) = parts(rebuilt), parts(shipped)
    assert frame == old_frame
    assert data.pop("wasm") == old.pop("wasm")
    assert numbers_of(data) == pytest.approx(numbers_of(old), rel=1e-9, abs=1e-12)
    assert json.dumps(data["sliders"][0]["key"]) == json.dumps(old["sliders"][0]["key"])
    assert len(shipped.encode()) <= LARGEST


def numbers_of(value: Any) -> list[float]:
    """All numbers in nested lists and dictionaries, in their order."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        collected: list[float] = []
        for item in value:
            collected += numbers_of(item)
        return collected
    return [float(value)] if isinstance(value, int | float) else []


def test_three_members_of_a_bank_share_their_functions() -> None:
    sizes = []
    for levels in (1, 3):
        scenario = scene(**BANK | {"observer": BANK["observer"] | {"levels": levels}})
        sizes.append(build_live_page(scenario).report["sizes"]["wasm"])
    assert sizes[1] < 1.8 * sizes[0]  # 2.7 written out


def test_the_same_scenario_gives_the_same_bytes() -> None:
    scenario = scene(simulation=SAMPLED)
    assert build_live_page(scenario).text == build_live_page(scenario).text


def test_its_policy_allows_its_own_script_alone() -> None:
    text = SHIPPED.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="(.*?)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy[1]
    frame, _ = parts(text)
    assert not re.search(r"https?:|//[a-z]|\bfetch\(|XMLHttp|WebSocket|@import|url\(", frame)


def test_the_command_writes_one_file_and_replaces_its_own_only(tmp_path: Path) -> None:
    scenario, out = scene(simulation=SAMPLED), tmp_path / "new" / "page.html"
    exported = uz.export(scenario, to="page", out=out)
    assert exported.files == [out]
    assert exported.has_passed
    assert exported.report["sizes"]["page"] == out.stat().st_size
    uz.export(scenario, to="page", out=out)
    foreign = tmp_path / "mine.html"
    foreign.write_text("<p>mine</p>")
    with pytest.raises(FileError, match="not replaced"):
        uz.export(scenario, to="page", out=foreign)
    assert foreign.read_text() == "<p>mine</p>"
    for option in (
        {"check": True},
        {"tunable": ("observer.gamma",)},
        {"name": "x"},
        {"precision": "single"},
    ):
        with pytest.raises(InputError, match="no such choice"):
            uz.export(scenario, to="page", out=out, **option)


def test_a_remainder_has_no_instruction() -> None:
    w = ca.SX.sym("w", 2)
    nodes = build_portable_nodes(
        ca.Function("f", [w], [ca.fmod(w[0], w[1])], ["w"], ["o"]), "float64"
    )
    with pytest.raises(InputError, match="remainder"):
        print_wasm.build_module([print_wasm.Function("f", nodes, {"w0": 0, "w1": 8}, [[16]])], 24)


def test_sliders_without_meaning_are_left_out() -> None:
    blind = scene(simulation=SAMPLED, observer={"method": "luenberger", "poles": [-3.0, -4.0]})
    data = parts(build_live_page(blind).text)[1]
    assert "gamma" not in [slider["key"] for slider in data["sliders"]]
    assert not data["learns"]
    several = msgspec.structs.replace(blind, reference=uz.Step(amplitude=2.0, time=0.1))
    keys = [slider["key"] for slider in parts(build_live_page(several).text)[1]["sliders"]]
    assert "speed" not in keys


def test_the_flat_ends_of_a_range_are_explained() -> None:
    """Only where there are some."""
    for sensor, explained in (({}, False), ({"range": [-3.0, 3.0]}, True)):
        text = build_live_page(scene(simulation=SAMPLED, sensor=sensor)).text
        assert ("stays flat" in text) == explained


def test_no_table_beside_a_picture_is_cut(page: Browser, tmp_path: Path) -> None:
    """The last column of intervals was, on a screen of 1280."""
    interval = "0.9936 [0.9867, 1.0004]"
    table = html.build_table(
        ("likelihood of", "d_r [rad]", "d_l [rad]"), [("single samples", interval, interval)]
    )
    drawn = html.Html("<figure><svg width='900' height='300'></svg></figure>")
    text = html.build_page("Widths", html.build_section("How sure?", table, drawn))
    path = tmp_path / "report.html"
    path.write_text(text.replace("<html", "<html data-numbers='1'", 1))
    page.open(path.as_uri())
    for width in (1100, 1280, 1440):
        page.sized(width, 900)
        assert page.value(
            "[...document.querySelectorAll('.wide')].every(t => t.scrollWidth <= t.clientWidth)"
        )


@pytest.mark.parametrize(
    ("gamma", "expected"), [([6.0, 6.0], (6.0, "1/s")), ([3.0, 6.0], (1.0, "×"))]
)
def test_gains_of_learning_that_differ_have_one_factor(
    gamma: list[float], expected: tuple[float, str]
) -> None:
    two = small("sampled", plant=TWO_OUTPUTS, observer={"method": "certified", "gamma": gamma})
    sliders = parts(build_live_page(two).text)[1]["sliders"]
    [slider] = [one for one in sliders if one["key"] == "gamma"]
    assert (slider["value"], slider["unit"]) == expected
