"""Elementary functions of fused lanes: their errors, in units of the last place.

And what they do beyond the usual numbers.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from decimal import Decimal, localcontext

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_engines import SPECIAL, identical, stateless

from undeadzone.compile import lanes
from undeadzone.compile.coefficients import FUSED
from undeadzone.compile.elementary import LANES_OWN as FUNCTIONS
from undeadzone.util.arrays import Array, Floats

ULPS = {"sin": 1.0, "cos": 1.0, "exp": 1.0, "log": 1.0, "erf": 1.5, "tanh": 3.0}
FAR = FUSED.far
PI = Decimal(
    "3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803"
)


@pytest.fixture(autouse=True, scope="module")
def nothing_compiled(own_cache: None) -> Iterator[None]:
    yield
    kernel.cache_clear()


@functools.cache
def kernel(width: int = 128) -> lanes.Kernel:
    x = ca.SX.sym("x")
    step = stateless([x], [getattr(ca, name)(x) for name in FUNCTIONS])
    return lanes.build_kernel(step, width=width, fused=True)


def computed(name: str, x: Array, width: int = 128) -> Floats:
    """A function of many numbers, by lanes."""
    outputs, _ = lanes.run_lanes(
        kernel(width), np.reshape(x, (-1, 1)), np.empty((1, 0)), np.empty(0)
    )
    return outputs[:, 0, FUNCTIONS.index(name)]


def series(x: Decimal, ratio: Callable[[int], Decimal]) -> Decimal:
    """The sum of terms x, -x^3 ratio(0), x^5 ratio(0) ratio(1), ..."""
    term, total, k = x, Decimal(0), 0
    while abs(term) > Decimal("1e-75") * abs(x):
        total, term, k = total + term, -term * x * x * ratio(k), k + 1
    return total


def sine(x: Decimal) -> Decimal:
    r = x - (x / (2 * PI)).to_integral_value() * 2 * PI
    return series(r, lambda k: 1 / Decimal((2 * k + 2) * (2 * k + 3)))


def error_function(x: Decimal) -> Decimal:
    if abs(x) > 6:
        return Decimal(1).copy_sign(x)
    return 2 * series(x, lambda k: Decimal(2 * k + 1) / ((k + 1) * (2 * k + 3))) / PI.sqrt()


def hyperbolic_tangent(x: Decimal) -> Decimal:
    if abs(x) < Decimal("1e-20"):
        return x
    return 1 - 2 / ((2 * x).exp() + 1) if abs(x) < 40 else Decimal(1).copy_sign(x)


EXACT: dict[str, Callable[[Decimal], Decimal]] = {
    "sin": sine,
    "cos": lambda x: sine(x + PI / 2),
    "exp": lambda x: x.exp(),
    "log": lambda x: x.ln(),
    "erf": error_function,
    "tanh": hyperbolic_tangent,
}


def numbers(name: str) -> Floats:
    """Numbers of every size for which a function is finite.

    There are more of them where it bends, and those next to its zeros.
    """
    random = np.random.default_rng(0)
    sizes = np.ldexp(random.uniform(1, 2, 600), random.integers(-1074, 1024, 600))
    usual = np.concatenate([random.normal(size=300), 3 * random.normal(size=300)])
    turns = np.arange(1, 300) * random.integers(1, 2**35, 299) * np.pi / 2
    subnormal, normal = random.uniform(-745.2, -700, 300), random.uniform(-700, 709.7, 600)
    near_1, about_1 = 1 + random.normal(size=300) * 1e-9, random.uniform(0.5, 2, 600)
    if name == "exp":
        edges = [subnormal, normal, [709.782712893384, -745.1332191019411]]
    elif name == "log":
        edges = [near_1, about_1, [1.0, 5e-324, 2.0**-1022, np.finfo(float).max]]
    else:
        edges = [random.uniform(-6, 6, 600), turns]
    x = np.concatenate([sizes, -sizes, usual, *edges])
    limits = {
        "sin": (-FAR, FAR),
        "cos": (-FAR, FAR),
        "exp": (-745.2, 709.7827128933841),
        "log": (5e-324, np.inf),
    }
    low, high = limits.get(name, (-np.inf, np.inf))
    return x[(low <= x) & (x <= high)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_errors_in_units_of_the_last_place(name: str) -> None:
    x = numbers(name)
    with localcontext() as context:
        context.prec, context.Emin, context.Emax = 80, -99999, 99999
        exact = [EXACT[name](Decimal(value)) for value in x.tolist()]
        errors = np.empty(x.size)
        for i, (value, truth) in enumerate(zip(computed(name, x).tolist(), exact, strict=True)):
            unit = Decimal(float(np.spacing(abs(float(truth)))))
            errors[i] = abs(Decimal(value) - truth) / unit
    assert x[errors > ULPS[name]].tolist() == []
    assert errors.max() > 0.4  # a reference that agrees with everything would be none


@pytest.mark.parametrize("name", FUNCTIONS)
@given(st.lists(st.floats(), min_size=1, max_size=128))
def test_any_number_gives_what_the_c_library_gives(name: str, given_numbers: list[float]) -> None:
    x = np.array([*given_numbers, *SPECIAL])
    if name in ("sin", "cos"):
        x = x[~(np.isfinite(x) & (np.abs(x) > FAR))]
    values = computed(name, x)
    expected = np.array([float(getattr(ca, name)(value)) for value in x.tolist()])
    with np.errstate(invalid="ignore"):
        close = np.abs(values - expected) <= (ULPS[name] + 1) * np.spacing(np.abs(expected))
    assert np.all(close | (values == expected) | np.isnan(values) & np.isnan(expected))
    zero = expected == 0
    assert np.array_equal(np.signbit(values[zero]), np.signbit(expected[zero]))


def test_angles_beyond_all_meaning_stay_on_the_circle() -> None:
    x = np.array([2 * FAR, -1e20, 1e308])
    assert computed("sin", x).tolist() == [0.0, -0.0, 0.0]
    assert computed("cos", x).tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("width", [1, 16])
def test_the_width_changes_no_bit(width: int) -> None:
    for name in FUNCTIONS:
        x = np.concatenate([SPECIAL, numbers(name)[::7]])
        assert identical(computed(name, x, width), computed(name, x))


def test_all_of_a_lane_is_vectorised_and_nothing_is_called() -> None:
    code = kernel().block.text
    assert re.findall(r"^declare .*@(?!llvm\.)", code, re.M) == []
    fused = re.findall(r"call .*@llvm\.fma\.(\w+)", code)
    assert len(fused) > 50
    assert not any(kind == "f64" for kind in fused)


def test_sine_and_cosine_share_their_arithmetic() -> None:
    x = ca.SX.sym("x")
    counts = []
    for angle in (x, 2 * x):
        step = stateless([x], [ca.sin(x), ca.cos(angle)])
        code = lanes.build_kernel(step, width=128, fused=True).block.text
        counts.append(len(re.findall(r"call .*@llvm\.fma", code)))
    shared, apart = counts
    assert shared == apart / 2
