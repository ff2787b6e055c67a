"""Noise from counters.

It has the generator's published answers, is Gaussian to the tails and independent, and has the same
bits from NumPy and from lanes.
"""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from undeadzone.compile import normal
from undeadzone.compile.philox import box_muller, philox
from undeadzone.errors import ShapeError
from undeadzone.signals import noise
from undeadzone.util.arrays import Floats

UNLIKELY = 1e-6  # of a test of true Gaussian numbers to fail, were the seed not fixed
STREAMS = [
    (noise.AFTER, 0),
    (noise.AFTER, 1),
    (noise.BEFORE, 0),
    (noise.DISTURBANCE, 0),
    (noise.DISTURBANCE, 3),
]
RUNS = [0, 1, 2, 1000, 2**32 - 1, 2**32, 2**63 - 1, 77, 5, 6, 7, 8, 9, 10, 11, 12]


pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def many() -> Floats:
    return noise.standard_normal_numbers(1, noise.AFTER, 10_000_000, 1)[:, 0]


def filled(first: int, count: int, seed: int = 3, runs: list[int] = RUNS) -> Floats:
    """Steps x streams x runs, by lanes."""
    numbers = np.full((count, len(STREAMS), len(runs)), np.nan)
    normal.fill_normal(
        numbers, first, seed, [noise.counter_word(*stream) for stream in STREAMS], runs
    )
    return numbers


def expected(count: int, seed: int = 3, runs: list[int] = RUNS) -> Floats:
    """The same by NumPy."""
    numbers = np.empty((count, len(STREAMS), len(runs)))
    for i, (stream, channel) in enumerate(STREAMS):
        for k, run in enumerate(runs):
            channels = noise.standard_normal_numbers(seed, stream, count, channel + 1, run)
            numbers[:, i, k] = channels[:, channel]
    return numbers


# --- The generator and the transform


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ([0, 0, 0, 0], [0, 0], [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_known_answers(counter: list[int], key: list[int], answer: list[int]) -> None:
    """Of Philox4x32-10, as published with Random123."""
    words = philox(*map(np.uint64, counter), np.uint64(key[0] | key[1] << 32))
    assert [int(word) for word in words] == answer


def textbook(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Box and Muller in float64.

    Args:
        a: the radius is that of u = (a + 1/2) / 2^32
        b: sign of the cosine, swap, 30 bits of angle in quarter turns
    """
    u = (a.astype(float) + 0.5) / 2**32
    rest = (0.5 + (0xFFFFFFFF - a.astype(float))) / 2**32  # 1 - u without cancellation
    radius = np.sqrt(-2 * np.where(u > 0.5, np.log1p(-rest), np.log(u)))
    turn = (b.astype(np.int64) % 2**30 * 4 + 2 + 2**31) % 2**32 - 2**31
    angle = turn * 2.0**-32 * np.pi / 2
    cosine = radius * np.cos(angle) * np.where(b >> 31, -1, 1)
    sine = radius * np.sin(angle)
    swap = b >> 30 & 1
    return np.where(swap, sine, cosine), np.where(swap, cosine, sine)


CORNERS = [0, 1, 2, 2**29 - 1, 2**29, 2**30 - 1, 2**30, 2**31 - 1, 2**31]
CORNERS += [0xBFFFFF80, 0xBFFFFFFF, 0xC0000000, 0xFFFFFFFE, 0xFFFFFFFF]


def test_box_muller_of_all_kinds_of_words() -> None:
    rng = np.random.default_rng(0)
    of_any_size = rng.integers(0, 2**32, 200_000, dtype=np.uint32)
    of_any_size >>= rng.integers(0, 32, 200_000, dtype=np.uint32)
    one, other = np.meshgrid(np.array(CORNERS, np.uint32), np.array(CORNERS, np.uint32))
    a = np.concatenate([one.ravel(), of_any_size])
    b = np.concatenate([other.ravel(), of_any_size])
    for words in ((a, b), (~a, b), (a, ~b), (b, a)):
        for found, exact in zip(box_muller(*words), textbook(*words), strict=True):
            assert found.dtype == np.float32
            assert np.abs(found / exact - 1).max() < 5e-7
            assert (found != 0).all()


@pytest.mark.parametrize(
    ("sigma", "tolerance"), [(4.0, 1e-5), (5.0, 1e-4), (5.5, 1e-3), (6.0, 5e-3)]
)
def test_tails_without_sampling(sigma: float, tolerance: float) -> None:
    """The share of angles beyond sigma at each radius that reaches it, over all words of radius.

    No number is drawn.
    """
    words = np.arange(2**32 * np.exp(-(sigma**2) / 2) + 2).astype(np.uint32)
    x, y = (part.astype(float) for part in box_muller(words, np.zeros_like(words)))
    angles = np.arccos(np.minimum(1.0, sigma / np.hypot(x, y))) / np.pi
    assert angles.sum() / 2**32 == pytest.approx(stats.norm.sf(sigma), rel=tolerance)


@pytest.mark.parametrize("bit", range(192))
def test_every_bit_of_counter_and_seed_changes_every_word(bit: int) -> None:
    rng = np.random.default_rng(bit)
    words = [
        *rng.integers(0, 2**32, (4, 1000), dtype=np.uint64),
        rng.integers(0, 2**64, 1000, dtype=np.uint64),
    ]
    before = philox(*words)
    changed = min(bit // 32, 4)  # four words of the counter, then the seed
    words[changed] ^= np.uint64(1) << np.uint64(bit - 32 * changed)
    for a, b in zip(before, philox(*words), strict=True):
        flips = [np.count_nonzero((a ^ b) >> np.uint32(k) & np.uint32(1)) for k in range(32)]
        assert stats.binom.cdf(min(flips), 1000, 0.5) > UNLIKELY / 1000
        assert stats.binom.sf(max(flips), 1000, 0.5) > UNLIKELY / 1000


# --- Gaussian, in ten million numbers


@pytest.mark.parametrize("sigma", [0.01, 1.0, 2.0, 3.0, 4.0, 5.0])
def test_as_many_numbers_beyond_sigma_as_there_should_be(many: Floats, sigma: float) -> None:
    for side in (many, -many):
        beyond = np.count_nonzero(side > sigma)
        assert stats.binomtest(beyond, many.size, stats.norm.sf(sigma)).pvalue > UNLIKELY


def test_moments(many: Floats) -> None:
    power = np.ones_like(many)
    for mean, variance in ((0, 1), (1, 2), (0, 15), (3, 96), (0, 945), (15, 10170)):
        power *= many
        deviation = np.sqrt(variance / many.size)
        assert abs(power.mean() - mean) < stats.norm.isf(UNLIKELY / 2) * deviation


def test_distribution(many: Floats) -> None:
    assert stats.kstest(many[:1_000_000], stats.norm.cdf).pvalue > UNLIKELY
    smallest = np.abs(many[np.abs(many) < 1e-3])
    assert stats.kstest(smallest * 1e3, stats.uniform.cdf).pvalue > UNLIKELY


# --- Independent


def cells(x: Floats) -> Floats:
    """To which of 16 equally likely cells each number belongs."""
    return np.searchsorted(stats.norm.ppf(np.arange(1, 16) / 16), x)


def assert_independent(x: Floats, y: Floats) -> None:
    """Every pair of cells is equally frequent, and sizes are uncorrelated also in the tails."""
    counts = np.bincount(16 * cells(x) + cells(y), minlength=256)
    assert stats.chisquare(counts).pvalue > UNLIKELY
    assert abs(np.corrcoef(x, y)[0, 1]) * np.sqrt(x.size) < stats.norm.isf(UNLIKELY / 2)
    assert abs(np.corrcoef(x**2, y**2)[0, 1]) * np.sqrt(x.size) < stats.norm.isf(UNLIKELY / 2)


@pytest.mark.parametrize("lag", [1, 2, 3, 4, 5, 7, 8, 100])
def test_steps_are_independent(many: Floats, lag: int) -> None:
    assert_independent(many[:400_000], many[lag : 400_000 + lag])
    assert_independent(many[: 4 * 400_000 : 4], many[lag : 4 * 400_000 + lag : 4])


NEXT = {
    "stream": {"stream": 1},
    "run": {"run": 1},
    "run of 2^32": {"run": 2**32},
    "seed": {"seed": 1},
    "seed of 2^32": {"seed": 2**32},
}


@pytest.mark.parametrize("change", NEXT.values(), ids=NEXT)
def test_streams_runs_and_seeds_are_independent(change: dict[str, int]) -> None:
    base = {"seed": 0, "stream": noise.AFTER, "samples": 400_000, "channels": 1}
    one, other = (
        noise.standard_normal_numbers(**base)[:, 0],
        noise.standard_normal_numbers(**base | change)[:, 0],
    )
    assert_independent(one, other)
    assert_independent(one[:-1], other[1:])


def test_channels_are_independent() -> None:
    one, other, last = noise.standard_normal_numbers(0, noise.AFTER, 400_000, 3).T
    assert_independent(one, other)
    assert_independent(one, last)


@pytest.mark.parametrize("varied", ["seed", "run"])
def test_one_step_across_many_seeds_or_runs_is_gaussian(varied: str) -> None:
    place = {"seed": 0, "stream": 0, "samples": 8, "channels": 2}
    parts = [noise.standard_normal_numbers(**place | {varied: k}) for k in range(3000)]
    numbers = np.concatenate(parts, axis=1)
    for row in numbers:
        assert stats.kstest(row, stats.norm.cdf).pvalue > UNLIKELY
    assert np.abs(np.corrcoef(numbers) - np.eye(8)).max() < 6 / np.sqrt(numbers.shape[1])


# --- A function of its place alone


def test_a_number_is_a_function_of_its_place() -> None:
    all_of_them = noise.standard_normal_numbers(4, noise.BEFORE, 1001, 3, run=9)
    for samples in (0, 1, 2, 3, 4, 5, 1000):
        fewer = noise.standard_normal_numbers(4, noise.BEFORE, samples, 3, run=9)
        assert np.array_equal(fewer, all_of_them[:samples])
    assert np.array_equal(
        noise.standard_normal_numbers(4, noise.BEFORE, 1001, 1, run=9), all_of_them[:, :1]
    )
    assert noise.standard_normal_numbers(4, noise.BEFORE, 10, 0).shape == (10, 0)


def test_no_two_places_share_numbers() -> None:
    seeds, streams = (0, 1, 2**32, 2**63 - 1), (noise.AFTER, noise.BEFORE, noise.DISTURBANCE)
    parts = []
    for seed, stream, run in itertools.product(seeds, streams, RUNS):
        parts.append(noise.standard_normal_numbers(seed, stream, 40, 3, run).ravel())
    numbers = np.concatenate(parts)
    # Of float32 some coincide; of two places alike it would be 120.
    assert np.unique(numbers).size > numbers.size - 60


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**63 - 1),
    first=st.integers(0, 25),
    count=st.integers(1, 14),
    run=st.integers(0, 2**63 - 1),
)
def test_lanes_draw_the_same_bits(seed: int, first: int, count: int, run: int) -> None:
    runs = [*RUNS[:-1], run]
    by_numpy = expected(first + count, seed, runs)[first:]
    assert np.array_equal(filled(first, count, seed, runs), by_numpy)


@pytest.mark.parametrize("width", [1, 3, 16, 128])
def test_bits_do_not_depend_on_the_number_of_lanes(width: int) -> None:
    runs = [*RUNS, *range(1000, 2000)][:width]
    assert np.array_equal(filled(0, 33, runs=runs), expected(33, runs=runs))


def test_steps_far_out() -> None:
    far = 10**10 + 3
    assert np.array_equal(filled(far, 9), np.concatenate([filled(far, 2), filled(far + 2, 7)]))
    counter = (far // 4, noise.counter_word(*STREAMS[1]), 5, 0)
    a, b, c, d = philox(*map(np.uint64, counter), np.uint64(3))
    assert filled(far, 1)[0, 1, RUNS.index(5)] == box_muller(c, d)[1]  # the last of four
    assert far % 4 == 3
    assert a != b


def test_threads_do_not_change_a_bit() -> None:
    with ThreadPoolExecutor(3) as pool:
        parts = list(pool.map(lambda first: filled(first, 50), range(0, 500, 50)))
    assert np.array_equal(np.concatenate(parts), expected(500))


# --- Coloured


CUTS = {"at once": [1000], "in parts": [1, 2, 5, 992], "three at a time": [3] * 333 + [1]}


@pytest.mark.parametrize("cuts", CUTS.values(), ids=CUTS)
def test_coloured_lanes_have_the_same_bits(cuts: list[int]) -> None:
    words = [noise.counter_word(noise.DISTURBANCE, channel) for channel in range(2)]
    state = np.full((2, len(RUNS)), np.nan)
    first, parts = 0, []
    for count in cuts:
        parts.append(np.empty((count, 2, len(RUNS))))
        normal.fill_normal(parts[-1], first, 3, words, RUNS)
        normal.colour_noise(parts[-1], state, first, *noise.first_order_coefficients(0.2, 0.01))
        first += count
    found = np.concatenate(parts)
    for j, run in enumerate(RUNS):
        assert np.array_equal(
            found[:, :, j], noise.stationary_first_order_noise(3, 1000, np.ones(2), 0.2, 0.01, run)
        )


def test_coloured_noise_has_its_rms_and_correlation_time() -> None:
    step, correlation = 0.01, 0.2
    found = noise.stationary_first_order_noise(3, 200_000, np.array([2.0, 0.5]), correlation, step)
    assert found.std(axis=0) == pytest.approx([2.0, 0.5], rel=0.05)
    lag = round(correlation / step)
    assert np.corrcoef(found[:-lag, 0], found[lag:, 0])[0, 1] == pytest.approx(np.exp(-1), abs=0.04)
    starts = [
        noise.stationary_first_order_noise(seed, 1, np.ones(1), correlation, step)
        for seed in range(2000)
    ]
    assert np.std(starts) == pytest.approx(1.0, abs=0.08)
    white = noise.standard_normal_numbers(3, noise.DISTURBANCE, 200_000, 2) * [2.0, 0.5]
    memory = np.exp(-step / correlation)
    driven = found[1:] - memory * found[:-1]
    np.testing.assert_allclose(driven, np.sqrt(1 - memory**2) * white[1:], atol=1e-14)
    assert np.array_equal(found[0], white[0])


# --- The compiled kernel


def test_lanes_are_drawn_by_vector_instructions() -> None:
    """The generator's products, the radius' root and the polynomials are of many lanes at once."""
    code = normal.fill_text(16)
    for wide in (
        r"mul .*<\d+ x i64>",
        r"fmul <\d+ x float>",
        r"@llvm.sqrt.v16f32",
        r"fpext <\d+ x float>",
    ):
        assert re.search(wide, code)
    assert "contract" not in code


def test_misuse_is_named() -> None:
    words = [noise.counter_word(noise.AFTER, 0)]
    for numbers in (np.empty((4, 2, 16)), np.empty((4, 1, 15))):
        with pytest.raises(ShapeError, match="numbers: expected steps x 1 channels x 16 lanes"):
            normal.fill_normal(numbers, 0, 0, words, RUNS)
    for state in (np.empty((2, 16)), np.empty((1, 15))):
        with pytest.raises(ShapeError, match="state: expected 1 x 16"):
            normal.colour_noise(np.empty((4, 1, 16)), state, 0, 0.5, 0.5)


SINGLE_RUN = """
import sys
import numpy
from undeadzone.signals import noise
noise.stationary_first_order_noise(0, 9, numpy.ones(1), 1.0, 0.1)
print({"llvmlite", "scipy.signal"} & sys.modules.keys())
"""


def test_a_single_run_needs_neither_llvm_nor_scipy_signal() -> None:
    command = [sys.executable, "-c", SINGLE_RUN]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
