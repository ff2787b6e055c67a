"""Test `deadzone_update` against `Censored`, the exact posterior, and the C header."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings

import once
import undeadzone as uz
from scenes import EXACT_SENSOR, linear, seeds
from undeadzone.interfaces import Reading
from undeadzone.nonlinearities.sensor import Sensor, deadzone, resolve, side
from undeadzone.numerics.deadzone_update import DeadzoneMemory, DeadzoneUpdate, deadzone_update
from undeadzone.plants.system import sample_plant
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

TS = 0.01
C, RIGHT, LEFT = np.eye(3)  # of [z; d_r; d_l]


def censored_update(mean: Any, cov: Any, **options: Any) -> DeadzoneUpdate:
    """Return the estimate after one censored sample of [z; d_r; d_l]."""
    arguments = {"right": RIGHT, "left": LEFT, "noise": 0.001, "rest": 5} | options
    return deadzone_update(mean, cov, C, 0.0, memory=DeadzoneMemory(), **arguments)


# --- One silence


def test_at_a_silent_start_z_is_inside_the_zone() -> None:
    """N(0, 10^2), ranges [.3, 2]: the exact answer is 0 +- .82 (4e6 draws)."""
    updated = censored_update([0.0, 1.15, 1.15], np.diag([100.0, 0.2408, 0.2408]))
    assert abs(updated.mean[0]) < 1e-12
    assert math.sqrt(updated.cov[0, 0]) == pytest.approx(0.82, abs=0.02)
    assert updated.mean[1] == pytest.approx(1.25, abs=0.02)
    assert math.sqrt(updated.cov[1, 1]) == pytest.approx(0.48, abs=0.02)


@pytest.mark.parametrize(("mean", "std"), [(0.0, 1.0), (1.0, 2.0), (3.0, 2.0), (10.0, 3.0)])
def test_known_edges_give_the_moments_of_a_cut_gaussian(mean: float, std: float) -> None:
    from scipy.stats import truncnorm

    updated = censored_update([mean, 0.0, 0.0], np.diag([std**2, 1.0, 1.0]), right=1.0, left=0.5)
    ends = ((-0.504 - mean) / std, (1.004 - mean) / std)  # 4 rms of noise beyond the edges
    expected, variance = truncnorm.stats(*ends, loc=mean, scale=std)
    assert updated.mean[0] == pytest.approx(expected, abs=2e-4)
    assert updated.cov[0, 0] == pytest.approx(variance, rel=2e-3)
    assert updated.mean[1:].tolist() == [0.0, 0.0]


@given(seed=seeds)
@settings(max_examples=60, deadline=None)
def test_silence_leaves_a_covariance_that_is_one(seed: int) -> None:
    """Whatever is believed, of zones that may be negative too."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) * np.exp(2 * rng.normal(size=3))[:, None]
    cov = root @ root.T
    mean = rng.normal(size=3) * np.exp(rng.normal())
    after = censored_update(mean, cov).cov
    scale = np.sqrt(np.diag(cov))
    assert np.linalg.eigvalsh(after / np.outer(scale, scale)).min() > -1e-9
    assert np.linalg.eigvalsh((cov - after) / np.outer(scale, scale)).min() > -1e-9


@pytest.mark.parametrize(("side", "edge", "waiting"), [(1, RIGHT, (5, 0)), (-1, LEFT, (0, 5))])
def test_a_narrow_estimate_uses_one_edge(side: int, edge: Any, waiting: tuple[int, int]) -> None:
    """As the cut at the edge that it contradicts alone, from the first reading on."""
    mean, cov = np.array([1.5 * side, 1.2, 1.2]), np.diag([0.04, 0.01, 0.01])
    updated = censored_update(mean, cov)
    h = side * C - edge
    std = math.sqrt(h @ cov @ h + 1e-6)
    alpha = (0.004 - h @ mean) / std
    density = math.exp(-(alpha**2) / 2) / math.sqrt(2 * math.pi)
    ratio = density / (math.erfc(-alpha / math.sqrt(2)) / 2)
    assert updated.mean == pytest.approx(mean - ratio * cov @ h / std)
    lost = ratio * (ratio + alpha) * np.outer(cov @ h, h @ cov) / std**2
    assert updated.cov == pytest.approx(cov - lost)
    assert (updated.memory.right, updated.memory.left) == waiting


# --- Beside the graph


def graph(noise: float, before: float, disturbance: float) -> Any:
    """(step of `Censored` on numbers, its first state, steps to wait)."""
    model = sample_plant(linear([[0.0, 1.0], [-4.0, -1.0]], [[0.0], [4.0]], [[1.0, 0.0]]), TS)
    zone = resolve(
        Sensor(right=1.0, left=1.0, noise=noise, noise_before=before, **EXACT_SENSOR), 1, TS, 2.0
    )
    options = uz.Censored(
        right=[0.3, 2.0],
        x_std=[2.0, 2.0],
        disturbance=disturbance,
        bias=0.0,
        tolerance=0.0,
        levels=1,
        glitches=0.0,
    )
    observer = options.build(model, zone)
    p, params = tree.create_symbols(observer.params, "p")
    s, state = tree.create_symbols(observer.init(observer.params), "s")
    w = ca.SX.sym("w", 2)
    reading = Reading(w[0], side(w[0]))
    after, _ = observer.step(params, state, w[1], reading)
    (moments,) = observer.smoothing.moments(params, state, w[1], reading)
    beliefs = [*moments.before, *moments.bounded, moments.edges]
    step = ca.Function("step", [s, w, p], [tree.stack_leaves(after), *beliefs], {"cse": True})
    numbers = tree.pack_tree(observer.params)
    first = tree.pack_tree(observer.init(observer.params))
    return (
        lambda s, w: [np.array(part) for part in step(s, w, numbers)],
        first,
        observer.params.rest,
    )


@pytest.mark.parametrize(
    ("noise", "before", "disturbance"), [(0.02, 0.0, 0.3), (0.0, 0.05, 0.3), (0.01, 0.02, 0.0)]
)
def test_the_graph_of_censored_computes_the_same_update(
    noise: float, before: float, disturbance: float
) -> None:
    """Mean and covariance after each of 600 readings, some of which are missing."""
    rng = np.random.default_rng(5)
    step, s, rest = graph(noise, before, disturbance)
    t = TS * np.arange(600)
    z = 1.6 * np.sin(3 * t) + 0.4 * np.sin(7 * t)
    memory, used = DeadzoneMemory(), [0, 0]
    for k in range(600):
        y = float(deadzone(z[k] + before * rng.normal(), 1.1, 0.8) + noise * rng.normal())
        y = math.nan if rng.uniform() < 0.05 else y
        s, mean, cov, expected, cov_after, edges = step(s, [y, 0.0])
        n = len(mean)
        right, left = np.eye(n)[2], np.eye(n)[3]
        updated = deadzone_update(
            mean,
            cov,
            edges[0] + right,
            y,
            right=right,
            left=left,
            noise=noise,
            noise_before=before,
            memory=memory,
            rest=math.ceil(rest),
        )
        scale = np.sqrt(np.diag(cov))
        assert updated.mean == pytest.approx(expected, rel=1e-7, abs=1e-9)
        gap = (updated.cov - cov_after) / np.outer(scale, scale)
        assert np.abs(np.nan_to_num(gap)).max() < 1e-7
        used[0] += updated.side != 0
        used[1] += updated.memory.right > memory.right or updated.memory.left > memory.left
        memory = updated.memory
    assert used[0] > 100
    assert used[1] >= 3


# --- Its readings


def test_a_reading_on_a_sure_side_is_a_kalman_update() -> None:
    mean, cov = np.array([2.0, 1.0, 1.0]), np.diag([1.0, 0.2, 0.2])
    updated = deadzone_update(
        mean,
        cov,
        C,
        3.0,
        right=RIGHT,
        left=LEFT,
        noise=0.1,
        memory=DeadzoneMemory(),
        rest=5,
        slope=2.0,
    )
    h = C - RIGHT
    S = h @ cov @ h + 0.05**2
    assert updated.side == 1
    assert updated.innovation == pytest.approx(1.5 - 1.0)
    assert updated.innovation_std == pytest.approx(math.sqrt(S))
    assert updated.mean == pytest.approx(mean + cov @ h / S * 0.5)
    assert updated.cov == pytest.approx(cov - np.outer(cov @ h, cov @ h) / S)
    assert updated.memory == DeadzoneMemory(3.0, 0.0, 0, 0)


def test_a_column_stays_a_column_and_nothing_is_changed_in_place() -> None:
    mean, cov = np.array([[2.0], [1.0], [1.0]]), np.eye(3)
    updated = deadzone_update(
        mean, cov, C, -3.0, right=1.0, left=LEFT, noise=0.1, memory=DeadzoneMemory(), rest=5
    )
    assert updated.mean.shape == (3, 1)
    assert updated.side == -1
    assert mean.ravel().tolist() == [2.0, 1.0, 1.0]
    assert (cov == np.eye(3)).all()


def test_a_missing_reading_changes_nothing() -> None:
    before = DeadzoneMemory(0.7, 0.5, 3, 0)
    updated = deadzone_update(
        [2.0, 1.0, 1.0],
        np.eye(3),
        C,
        math.nan,
        right=RIGHT,
        left=LEFT,
        noise=0.1,
        memory=before,
        rest=5,
    )
    assert updated.mean.tolist() == [2.0, 1.0, 1.0]
    assert updated.memory == DeadzoneMemory(0.0, 0.7, 2, 0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"noise": 0.0}, "noise: expected some rms"),
        ({"noise": -0.1}, "noise: expected some rms"),
        ({"slope": 0.0}, "slope: must be positive"),
        ({"right": -1.0}, "right: a known width"),
        ({"left": [1.0, 0.0]}, "left: expected a row of 3 numbers"),
        ({"cov": np.eye(2)}, "cov: expected 3 x 3"),
        ({"cov": np.diag([1.0, -1.0, 1.0])}, "cov: expected a covariance"),
        ({"cov": 3 * np.ones((3, 3)) - 2 * np.eye(3)}, "cov: expected a covariance"),
        ({"cov": np.eye(3) + np.eye(3, k=1) / 2}, "not symmetric"),
        ({"cov": np.full((3, 3), math.nan)}, "cov: expected finite"),
        ({"mean": [math.nan, 1.0, 1.0]}, "mean: expected finite"),
        ({"C": [math.inf, 0.0, 0.0]}, "C: expected finite"),
        ({"right": [0.0, math.nan, 0.0]}, "right: expected finite"),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, Any], words: str) -> None:
    given_ = {"mean": [0.0, 1.0, 1.0], "cov": np.eye(3), "C": C, "y": 0.0, "right": RIGHT}
    given_ |= {"left": LEFT, "noise": 0.1, "memory": DeadzoneMemory(), "rest": 5}
    with pytest.raises(uz.InputError, match=words):
        deadzone_update(**given_ | changes)


@pytest.mark.parametrize("y", [0.0, 3.0])
def test_an_edge_at_infinity_is_no_edge(y: float) -> None:
    """As one that is far away; a reading beyond it is not used."""
    options = {"left": LEFT, "noise": 0.02, "memory": DeadzoneMemory(), "rest": 5}
    mean, cov = [-1.5, 1.0, 1.0], np.diag([1.0, 0.2, 0.2])
    updated = deadzone_update(mean, cov, C, y, right=math.inf, **options)
    assert updated.side == 0
    assert np.isfinite(updated.cov).all()
    if y == 0.0:
        far = deadzone_update(mean, cov, C, y, right=1e9, **options)
        assert updated.mean == pytest.approx(far.mean, abs=1e-12)
        assert updated.cov == pytest.approx(far.cov, abs=1e-12)
        assert updated.mean[0] > -1.5


# --- In C

ANY = """
#define DEADZONE_REAL double
#include "deadzone_update.h"
#include <stdio.h>
int main(void) {
  double v[23], work[6];
  for (;;) {
    for (int i = 0; i < 23; i++) if (scanf("%lf", v + i) != 1) return i;
    int m[5];
    for (int i = 0; i < 5; i++) if (scanf("%d", m + i) != 1) return 1;
    double *C = v, *x = v + 3, *P = v + 6, *w = v + 15;
    DeadzoneSensor s = {C, {m[0], m[1]}, {w[0], w[1]}, w[2], w[3], w[4], m[4]};
    DeadzoneMemory memory = {w[5], w[6], {m[2], m[3]}};
    printf("%d", deadzone_update(&memory, &s, 3, x, P, w[7], work));
    printf(" %.17g %.17g %d %d", memory.last, memory.previous, memory.wait[0], memory.wait[1]);
    for (int i = 0; i < 3; i++) printf(" %.17g", x[i]);
    for (int i = 0; i < 9; i++) printf(" %.17g", P[i]);
    printf("\\n");
  }
}
"""
REST = 5
PLACES = np.eye(3)
NO_MEMORY = DeadzoneMemory()


class Case(NamedTuple):
    """One reading for both.

    Attributes:
        widths: right and left; a place in the mean, or a known width below it.
        at: places of the widths in the mean, -1 where they are known.
    """

    mean: Floats
    cov: Floats
    C: Floats = PLACES[0]
    widths: tuple[float, float] = (1.0, 0.0)
    at: tuple[int, int] = (-1, 2)
    noise: float = 0.1
    before: float = 0.0
    slope: float = 1.0
    y: float = 0.0
    memory: DeadzoneMemory = NO_MEMORY

    def update(self) -> DeadzoneUpdate:
        """What Python makes of it."""
        right, left = (
            PLACES[at] if at > 0 else width for at, width in zip(self.at, self.widths, strict=True)
        )
        options = {"noise": self.noise, "noise_before": self.before, "slope": self.slope}
        return deadzone_update(
            self.mean, self.cov, self.C, self.y, right=right, left=left,
            memory=self.memory, rest=REST, **options,
        )  # fmt: skip

    def line(self) -> str:
        """The numbers for the program."""
        last, previous, *waits = self.memory
        sensor = [*self.widths, self.noise, self.before, self.slope, last, previous, self.y]
        numbers = [*self.C, *self.mean, *self.cov.ravel(), *sensor]
        return " ".join([*map(repr, map(float, numbers)), *map(str, [*self.at, *waits, REST])])


def in_header(cases: list[Case], folder: Path) -> Floats:
    """Results of the header for cases: (side, memory, x, P) a row."""
    return run_header(ANY, [case.line() for case in cases], folder)


def run_header(main: str, lines: Iterable[Any], folder: Path) -> Floats:
    """Rows that a program prints of lines; it takes the header, compiled with all warnings."""
    header = files("undeadzone.numerics") / "deadzone_update.h"
    (folder / "deadzone_update.h").write_text(header.read_text())
    (folder / "main.c").write_text(main)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1"]
    program = once.program(["deadzone_update", *flags, "main.c"], folder)
    text = "\n".join(map(str, lines))
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return np.array([line.split() for line in done.stdout.splitlines()], float)


def extreme(rng: np.random.Generator) -> Case:
    """A belief over 24 orders of magnitude, singular or not, and any sensor and reading."""
    scale = 10.0 ** (rng.uniform(-8, 8) + rng.uniform(-4, 4, 3))
    root = rng.normal(size=(3, 3)) * scale[:, None]
    kind = rng.integers(4)
    if kind == 0:
        root[:, 1:] *= 10.0 ** rng.uniform(-8, 0)
    if kind == 1:
        root[rng.integers(3)] = 0.0
    cov = root @ root.T
    mean = np.sqrt(np.diag(cov)) * rng.normal(size=3) * 10.0 ** rng.uniform(-2, 2.5)
    unit = math.sqrt(cov[0, 0]) or 1.0
    widths = [float(rng.choice([math.inf, 0.0, unit * 10.0 ** rng.uniform(-3, 3)])) for _ in "rl"]
    before = float(rng.choice([0.0, unit * 10.0 ** rng.uniform(-4, 1)]))
    noise = 0.0 if before and rng.integers(3) == 0 else unit * 10.0 ** rng.uniform(-4, 2)
    gate = 4 * noise or unit
    readings = (0.0, 0.0, 0.0, 0.7, 1.3, 2.5, -2.5, -0.9, 50.0, math.nan)
    last, previous = rng.choice([0.0, 1.2, -1.5, 3.0], 2) * gate
    waits = map(int, rng.choice([0, 0, 0, 1, 3], 2))
    return Case(
        mean, (cov + cov.T) / 2, PLACES[0] if rng.integers(2) else rng.normal(size=3),
        (widths[0], widths[1]), (int(rng.choice([-1, 1])), int(rng.choice([-1, 2]))),
        noise, before, 10.0 ** rng.uniform(-2, 2), float(rng.choice(readings)) * gate,
        DeadzoneMemory(float(last), float(previous), *waits),
    )  # fmt: skip


def is_resolved(case: Case) -> bool:
    """Whether the noise is more than rounding of the variances along the edges."""
    C, (right, left) = case.C, case.at
    rows = C - (PLACES[right] if right > 0 else 0), -C - (PLACES[left] if left > 0 else 0)
    most = max(row @ case.cov @ row for row in rows)
    return bool((case.noise / case.slope) ** 2 + case.before**2 > 1e-10 * most)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("deadzone_update")


@given(seed=seeds)
@settings(max_examples=40, deadline=None)
def test_the_header_agrees_at_extremes(seed: int, folder: Path) -> None:
    """To 1e-6 of a deviation; both choose the same edges, and wait alike."""
    rng = np.random.default_rng(seed)
    cases = [case for case in (extreme(rng) for _ in range(60)) if is_resolved(case)]
    for row, case in zip(in_header(cases, folder), cases, strict=True):
        updated = case.update()
        std = np.sqrt(np.diag(case.cov))
        std[std == 0] = 1.0
        assert row[0] == updated.side, case
        assert tuple(row[1:5]) == tuple(updated.memory), case
        assert np.abs((row[5:8] - updated.mean) / std).max() < 1e-6, case
        gap = np.abs(row[8:].reshape(3, 3) - updated.cov) / np.outer(std, std)
        assert gap.max() < 1e-6, case


def test_an_estimate_far_beyond_both_edges_chooses_the_same(folder: Path) -> None:
    case = Case(np.array([1e6, 0.0, -3e6]), 1e-4 * np.eye(3), widths=(0.5, 0.0), noise=0.02)
    (row,) = in_header([case], folder)
    assert row[5:8] == pytest.approx(case.update().mean, rel=1e-12)


def test_both_refuse_what_cannot_be(folder: Path) -> None:
    """The last: a variance of 1e16 along an edge, less itself; of noise rounding leaves nothing."""
    pair = 1e16 * np.array([[1.0, 1.0, 0], [1.0, 1.0 - 4e-16, 0], [0, 0, 1e-16]])
    cases = [
        Case(np.array([math.nan, 0, 1]), np.eye(3)),
        Case(np.zeros(3), -np.eye(3)),
        Case(np.zeros(3), np.eye(3) + 3 * np.eye(3, k=1) + 3 * np.eye(3, k=-1)),
        Case(np.zeros(3), np.full((3, 3), math.nan)),
        Case(np.zeros(3), pair, at=(1, 2), noise=1e-3),
    ]
    assert in_header(cases, folder)[:, 0].tolist() == [2.0] * len(cases)
    for case in cases:
        with pytest.raises(uz.InputError, match=r"mean|cov"):
            case.update()


SHAPED = """
#define DEADZONE_REAL double
#include "deadzone_update.h"
#include <stdio.h>
int main(void) {
  double C[] = {1, 0, 0, 0}, x[] = {0, 2, 1.15, 1.15}, P[16] = {0}, work[8], S[12] = {0}, y;
  DeadzoneSensor s = {C, {2, 3}, {0, 0}, 0.02, 0, 2, 5};
  DeadzoneShape shape = {0.05, 0, S};
  DeadzoneMemory memory = {0};
  P[0] = 25; P[5] = 1; P[10] = P[15] = 0.24;
  while (scanf("%lf", &y) == 1) {
    deadzone_update_shape(&memory, &s, &shape, 4, x, P, y, work);
    for (int i = 0; i < 12; i++) printf(" %.17g", S[i]);
    printf("\\n");
    for (int i = 0; i < 4; i++) P[5 * i] += 0.001 * (i < 2);
    x[0] += 0.01 * x[1];
    for (int i = 0; i < 3; i++) S[4 * i] += 0.01 * S[4 * i + 1];
    shape.ahead = 0.01 * x[1];
  }
  return 0;
}
"""


def test_the_header_moves_the_columns_alike(tmp_path: Path) -> None:
    """Those of a sensor with a shape, which the gate of round edges leaves fewer readings."""
    rng = np.random.default_rng(1)
    z = 2 * np.sin(0.05 * np.arange(300))
    readings = deadzone(z, 1.0, 0.8, 2.0) + 0.02 * rng.normal(size=300)
    rows = run_header(SHAPED, readings, tmp_path)
    x, P, memory = np.array([0, 2, 1.15, 1.15]), np.diag([25, 1, 0.24, 0.24]), DeadzoneMemory()
    eye, S, F, ahead = np.eye(4), np.zeros((4, 3)), np.eye(4), 0.0
    F[0, 1] = 0.01
    for y, row in zip(readings, rows, strict=True):
        shape = {"rounding": 0.05, "columns": S, "ahead": ahead}
        updated = deadzone_update(
            x,
            P,
            eye[0],
            y,
            right=eye[2],
            left=eye[3],
            noise=0.02,
            slope=2.0,
            memory=memory,
            rest=5,
            **shape,
        )
        assert row == pytest.approx(updated.columns.T.ravel(), rel=1e-6, abs=1e-8)
        P, memory = updated.cov + np.diag([0.001, 0.001, 0, 0]), updated.memory
        x, S, ahead = F @ updated.mean, F @ updated.columns, 0.01 * updated.mean[1]
    assert np.abs(S).max(axis=0).min() > 0.005


@pytest.mark.parametrize("name", ["slope_std", "rounding", "lag"])
def test_columns_are_how_far_a_mean_moves_with_the_sensor(name: str) -> None:
    """Against the mean of the same filter on the readings of a sensor that is a little other."""
    t, eye, F, h = 0.05 * np.arange(400), np.eye(3), np.eye(3), 1e-5
    z, v = 2.0 * np.sin(t), 0.1 * np.cos(t)
    y, zone = deadzone(z, 1.0, 0.8), np.sign(deadzone(z, 1.0, 0.8))
    other = {
        "slope_std": y,
        "rounding": zone * np.exp(-np.abs(y) / (1.4 * 0.05)),
        "lag": -v * (zone != 0),
    }[name]

    def follow(readings: Floats) -> tuple[Floats, Floats, Floats]:
        mean, cov, memory, S = (
            np.array([0.0, 1.1, 0.9]),
            np.diag([4, 0.1, 0.1]),
            DeadzoneMemory(),
            None,
        )
        for k, one in enumerate(readings):
            options = {
                "right": eye[1],
                "left": eye[2],
                "noise": 0.01,
                "memory": memory,
                "rest": 1000,
            }
            shape = {"rounding": 0.05, name: 0.05, "columns": S, "ahead": v[k]}
            updated = deadzone_update(mean, cov, eye[0], one, **options, **shape)
            mean, memory, S = (
                updated.mean + np.array([v[k], 0.0, 0.0]),
                updated.memory,
                updated.columns,
            )
            cov = F @ updated.cov @ F.T + np.diag([1e-4, 0, 0])
        return mean, updated.columns, updated.shown - updated.cov

    mean, columns, wide = follow(y)
    place = ["slope_std", "rounding", "lag"].index(name)
    moved = (follow(y + h * other)[0] - mean) / h
    assert np.abs(moved[1:] - columns[1:, place]).max() < 0.2 * np.abs(columns[1:, place]).max()
    assert np.linalg.eigvalsh(wide)[0] > -1e-12 < np.trace(wide)
