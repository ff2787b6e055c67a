"""The paper's audit: numbers against closed forms, verdicts against numbers, files whole."""

from __future__ import annotations

import csv
import dataclasses
import importlib
import itertools
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
from test_docs import PAGES, same

import once
import undeadzone_paper
from documents import EXAMPLES, script_of_docs
from undeadzone.linalg.riccati import paper_riccati
from undeadzone.plants.options import linear_matrices
from undeadzone.registry import CONTROLLERS
from undeadzone.results.run import Run
from undeadzone.scenario.reader import read
from undeadzone.simulation.simulate import simulate
from undeadzone_paper import Paper, measures, write
from undeadzone_paper.claims import (
    Claim,
    ClaimText,
    claims_on,
    read_claim_texts,
    verdict_counts_text,
)
from undeadzone_paper.equations import EQUATIONS, FIGURES
from undeadzone_paper.evidence import BEGUN, CONDITIONS, NOMINAL, RESTING, TABLES
from undeadzone_paper.example import (
    ALPHA,
    L_POLES,
    L_PRINTED,
    READINGS,
    D,
    example_as_printed,
    example_as_repaired,
)
from undeadzone_paper.figures import add_hats
from undeadzone_paper.printed import DURATION, GAINS, STARTS, STEP, example_of_variant
from undeadzone_paper.trials import (
    calm_share,
    controller_operations,
    destabilising_alpha,
    innovation_loop_pole,
    measure_claims,
    observer_operations,
    pole_error,
    rightmost_pole,
)

HOME = Path(undeadzone_paper.__file__).with_name("claims.toml")
STEADY = 5.0 / (1.0 + 4.0 * np.pi**2)


@pytest.fixture(scope="module")
def written(paper: Paper, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write(paper, tmp_path_factory.mktemp("paper") / "new" / "folder")


@pytest.fixture(scope="module")
def five(paper: Paper) -> Run:
    return paper.evidence.repaired[NOMINAL][0]


def test_measured_facts_agree_with_their_closed_forms(paper: Paper) -> None:
    assert len(paper.facts) > 30
    for fact in paper.facts:
        assert fact.relative_error < 2e-5, fact


def test_facts_hold_the_numbers_that_the_theory_states(paper: Paper) -> None:
    found = {(fact.where, fact.what): fact.measured for fact in paper.facts}
    stated = {
        ("omega_n = 1", "rightmost pole of A - L C, (40)"): 1.43,
        ("omega_n = 1", "leftmost pole of A - L C, (40)"): -2.18,
        ("omega_n = 1", "l1 for poles -4, -10"): 12.0,
        ("omega_n = 1", "l2 for poles -4, -10"): 15.0,
        ("omega_n = 2 pi", "rightmost pole of A - L C, (40)"): -2.52,
        ("omega_n = 2 pi", "l2 for poles -4, -10"): -17.49,
        ("stiffness 2 pi", "l2 for poles -4, -10"): 15.70,
        ("omega_n = 1, (34) with A - L C, L = (12, 15)", "rightmost pole of A - B K"): 0.0244,
        ("omega_n = 1, L = (12, 15)", "min Re(1 + G(jw))"): -0.0417,
        ("omega_n = 1, u = 5 sin 2 pi t", "peak of |z| from rest"): 0.413,
        ("omega_n = 1, u = 2 sin 2 pi t", "peak of |z| from rest"): 0.165,
        ("omega_n = 2 pi, u = 5 sin 2 pi t", "steady amplitude of z"): 0.0633,
        ("omega_n = 2 pi, u = 5 sin 2 pi t", "peak of |z| from rest"): 0.0753,
        ("unity DC gain, u = 5 sin 2 pi t", "steady amplitude of z"): 2.5,
    }
    for key, value in stated.items():
        assert found[key] == pytest.approx(value, rel=6e-3), key


def test_as_printed_from_rest_the_sensor_never_speaks(paper: Paper) -> None:
    literal = paper.evidence.printed[NOMINAL][RESTING][0]
    numbers = paper.summary()["printed"]
    assert numbers["max_abs_z"] == pytest.approx(STEADY, rel=0.01)
    assert numbers["max_abs_y"] == 0.0
    assert (literal.y == 0.0).all()
    assert (literal.d_hat == D).all()
    assert (literal.x_hat == 0.0).all()
    np.testing.assert_allclose(literal.u, literal.r, atol=1e-9)


def test_as_printed_but_started_outside_the_widths_run_off_or_the_loop_diverges(
    paper: Paper,
) -> None:
    printed = paper.evidence.printed[NOMINAL]
    begun, signed = printed[BEGUN][0], printed["from x1 = 5 with d_l < 0"][0]
    assert begun.divergence_time is None
    assert measures.width_error(begun) > D
    assert (begun.V[-1] - begun.V.min()) > 0.1 * begun.V[0]  # V of (30) rises
    assert signed.divergence_time is not None


def test_repaired_tracks_estimates_and_finds_the_widths(paper: Paper) -> None:
    for key in ("repaired", "repaired_2sin", "repaired_sampled"):
        numbers = paper.summary()[key]
        assert numbers["rms_tracking"] < 1e-3, key
        assert numbers["rms_estimation"] < 1e-3, key
        assert numbers["d_right"] == pytest.approx(D, abs=1e-3), key
        assert numbers["d_left"] == pytest.approx(D, abs=1e-3), key
        assert numbers["certified"], key


def test_repaired_V_never_rises_beyond_the_stated_integration_error(paper: Paper) -> None:
    for run in paper.evidence.repaired[NOMINAL]:
        assert run.info.integration_error < 1e-8
        assert np.diff(run.V).max() <= run.info.integration_error * run.V.max()
    assert np.diff(paper.evidence.repaired["sampled"][0].V).max() <= 0.0


def test_rate_agrees_with_the_fall_of_V(five: Run) -> None:
    half = five.t.size // 2
    of_V = np.log(five.V[half] / five.V[-1]) / 2 / (five.t[-1] - five.t[half])
    assert measures.width_convergence_rate(five) == pytest.approx(of_V, rel=0.01)


def test_repaired_is_the_example_that_ships(five: Run) -> None:
    shipped = read(EXAMPLES / "paper_5sin.toml")
    np.testing.assert_array_equal(five.d_hat, simulate(shipped, check_step=False).d_hat)


def test_every_variant_is_run_once(paper: Paper) -> None:
    assert len(paper.variants) == len(READINGS) * len(STARTS) * len(GAINS) * 2**4
    assert len({outcome.variant for outcome in paper.variants}) == len(paper.variants)
    counted = {(item.plant, item.start) for item in paper.count_variants}
    assert counted == set(itertools.product(READINGS, STARTS))
    assert all(item.total == 48 for item in paper.count_variants)
    for sign in ("sigma", "pd_sign", "left_sign"):
        assert {getattr(outcome.variant, sign) for outcome in paper.variants} == {1.0, -1.0}


def test_variants_from_rest_with_true_widths_leave_the_zone_only_with_unity_dc_gain(
    paper: Paper,
) -> None:
    for item in paper.count_variants:
        if item.start == "from rest, d^(0) = d":
            unity = item.plant == "unity DC gain"
            assert item.leave_zone == (48 if unity else 0)
            assert unity or (item.move_widths, item.diverge) == (0, 0)


def test_variants_with_unknown_widths_move_them_only_where_the_observer_is_fed(
    paper: Paper,
) -> None:
    for outcome in paper.variants:
        variant = outcome.variant
        if variant.start == "from rest, d^(0) = 0" and variant.plant != "unity DC gain":
            assert outcome.moves_widths == variant.feeds_input


def test_outcomes_are_consistent(paper: Paper) -> None:
    assert any(outcome.diverged_at is not None for outcome in paper.variants)
    for outcome in paper.variants:
        assert outcome.leaves_zone == (outcome.peak > D)
        assert (outcome.steady is None) == (outcome.diverged_at is not None)
        assert outcome.steady is None or outcome.steady <= outcome.peak


@pytest.mark.parametrize("index", [0, 151, 230, 389, 575])
def test_a_variant_in_the_shared_graph_equals_its_own_loop(paper: Paper, index: int) -> None:
    outcome = paper.variants[index]
    run = simulate(example_of_variant(outcome.variant), check_step=False)
    if outcome.diverged_at is None:
        assert outcome.peak == pytest.approx(float(np.abs(run.z).max()), rel=1e-9)
        last = run.z[run.t > DURATION - 4.0 + STEP / 2]
        assert outcome.steady == pytest.approx(float(np.abs(last).max()), rel=1e-9)
    else:
        assert np.abs(run.u[run.t < outcome.diverged_at - STEP / 2]).max() < 1e6


def test_each_claim_has_one_text_and_one_measurement(paper: Paper) -> None:
    ids = [text.id for text in read_claim_texts()]
    assert len(set(ids)) == len(ids)
    assert set(measure_claims(paper.evidence)) == set(ids)
    assert [claim.text.id for claim in paper.claims] == ids


def test_the_home_of_the_claims_has_no_verdict() -> None:
    """It has the paper's words, what is tested, a limit; no key, no reason says how it ends."""
    allowed = set(ClaimText._fields) - {"id"}
    for key, entry in tomllib.loads(HOME.read_text(encoding="utf-8")).items():
        assert set(entry) <= allowed, key
        assert entry["words"], key
        assert not re.search(r"\b(not shown|does not hold|holds after)\b", entry["why"]), key


def test_every_verdict_turns_with_its_numbers(paper: Paper) -> None:
    for claim in paper.claims:
        beyond = claim.text.limit + 1.0
        within = claim._replace(printed={"": claim.text.limit}, repaired=beyond)
        assert within.verdict == "holds"
        assert claim._replace(printed={"": beyond}, repaired=beyond).verdict != "holds"
        mended = claim._replace(printed={"": beyond}, repaired=claim.text.limit).verdict
        assert mended == ("not shown" if claim.text.announced else "holds after repair")
        assert claim._replace(printed={}, repaired=None).verdict in ("does not hold", "not shown")


def test_no_other_file_states_a_claim() -> None:
    """Code has the claims by their ids; pages have them between marks, or by a link."""
    statements = [
        entry["claim"] for entry in tomllib.loads(HOME.read_text(encoding="utf-8")).values()
    ]
    docs = script_of_docs("claims")
    found = []
    for path in {*HOME.parent.glob("*.py"), *PAGES} - {*docs.DOCS.glob("paper*.md")}:
        text = docs.MARKED.sub("", path.read_text(encoding="utf-8"))
        quoted = [claim for claim in statements if claim in " ".join(text.split())]
        stated = re.findall(r"destabilis\w+ the plant|cannot place|does not place", text)
        found += [(path.name, words) for words in (*quoted, *stated)]
    assert not found


def test_pages_say_what_the_audit_found(paper: Paper) -> None:
    """Words to the letter, numbers to 2 %."""
    docs = script_of_docs("claims")
    pages = {path: docs.filled(path, paper) for path in docs.marked()}
    assert {path.name for path in pages} >= {
        "README.md",
        "observer.md",
        "pd.md",
        "simple_observers.md",
    }
    for path, text in {**pages, **docs.pages(paper)}.items():
        written, rebuilt = path.read_text(encoding="utf-8").split(), text.split()
        same(" ".join(written), " ".join(rebuilt), f"{path.name}: run python docs/claims.py")


def test_claims_are_counted_in_a_sentence(paper: Paper) -> None:
    verdicts = paper.summary()["verdicts"]
    sentence = verdict_counts_text(paper.claims)
    assert sentence.startswith("No statement that the design works holds as printed. ")
    assert f"Of all {len(paper.claims)} statements {verdicts['holds']} hold as printed" in sentence
    works = [claim for claim in paper.claims if claim.text.works]
    mended = sum(claim.verdict == "holds after repair" for claim in works)
    assert f"Of {len(works)} such, {mended} hold after repair" in sentence


def test_the_headline_follows_the_verdicts(paper: Paper) -> None:
    works = next(claim for claim in paper.claims if claim.text.works)
    holding = works._replace(printed={"": works.text.limit})
    sentence = verdict_counts_text([holding])
    assert sentence.startswith(
        "1 statement that the design works holds as printed. Of 1 such, 0 hold"
    )


def test_claims_are_found_by_figure_and_by_assumption(paper: Paper) -> None:
    texts = read_claim_texts()
    assert claims_on("figure", 3, texts) == ["reading-tracked", "figures-3-4"]
    assert claims_on("figure", 8, texts) == ["beta", "adaptation-bounded"]
    assert claims_on("assumption", 2, texts) == ["physical", "unknown-width"]
    for number in range(1, 9):
        assert claims_on("figure", number, texts), number
    for number in range(1, 5):
        assert claims_on("assumption", number, texts), number


def test_equations_name_the_claims_that_judge_them(paper: Paper) -> None:
    assert claims_on("equation", 34, read_claim_texts()) == ["riccati-gain", "lyapunov"]
    assert claims_on("equation", 29, read_claim_texts())[0] == "theorem"
    assert claims_on("equation", 40, read_claim_texts()) == ["observer-poles"]
    equations = {entry["number"]: entry for entry in paper.summary()["equations"]}
    assert equations[7]["claims"] == ["indicators"]
    assert equations[28]["status"] == "corrected"  # chi_bar in it is that of (21)


@pytest.mark.parametrize(
    ("values", "repaired_value", "verdict"),
    [
        ((0.5, 1.0), 9.0, "holds"),
        ((0.5, 1.1), 1.0, "holds after repair"),
        ((np.inf,), 0.0, "holds after repair"),
        ((2.0,), np.inf, "does not hold"),
    ],
)
def test_verdict_follows_from_numbers_and_limit(
    values: tuple[float, ...], repaired_value: float, verdict: str
) -> None:
    text = read_claim_texts()[0]._replace(limit=1.0)
    claim = Claim(text, {f"case {i}": value for i, value in enumerate(values)}, repaired_value)
    assert claim.verdict == verdict == claim.summary()["verdict"]
    assert ("diverges" in claim.numbers_text) == bool(np.isinf([*values, repaired_value]).any())
    json.dumps(claim.summary(), allow_nan=False)


def test_the_claims_that_matter_come_out_as_derived(paper: Paper) -> None:
    verdicts = {claim.text.id: claim.verdict for claim in paper.claims}
    repaired_claims = ("lyapunov", "state-1", "state-2", "reading-tracked", "widths", "tracking")
    for name in (*repaired_claims, "cancelled", "bounded"):
        assert verdicts[name] == "holds after repair", name
    for name in ("adaptation-bounded", "unknown-width", "global", "symmetric"):
        assert verdicts[name] == "holds after repair", name
    for name in ("cancelled-in-total", "implied", "others-too-complex", "reference-amplitude"):
        assert verdicts[name] == "does not hold", name
    for name in ("compared", "effort", "beta", "tanh-term", "keyword", "figures-3-4"):
        assert verdicts[name] == "not shown", name
    for name in ("theorem", "theorem-known", "theorem-bounded", "manipulator", "practical-use"):
        assert verdicts[name] == "holds after repair", name
    for name in ("chattering", "mismatch", "input-easier", "output-harder", "reference-centre"):
        assert verdicts[name] == "holds", name
    for name in ("riccati-gain", "unit-slope", "predetermined", "unstable"):
        assert verdicts[name] == "holds", name
    for name in ("filtering", "identification"):
        assert verdicts[name] == "holds", name


def test_the_authors_own_doubt_is_quoted(paper: Paper) -> None:
    manipulator = next(claim for claim in paper.claims if claim.text.id == "manipulator")
    assert "may not have been directly verified" in manipulator.text.why


def test_with_40_every_alpha_stabilises_and_with_the_required_poles_only_those_below_nine() -> None:
    plant = linear_matrices(example_as_printed(1.0).plant)
    drifts = [plant.A - np.reshape(L, (2, 1)) @ plant.C for L in (L_PRINTED, L_POLES)]
    for alpha in np.geomspace(CONDITIONS["least_alpha"], CONDITIONS["most_alpha"], 31):
        assert rightmost_pole(plant, drifts[0], alpha) < 0.0
        assert (rightmost_pole(plant, drifts[1], alpha) < 0.0) == (alpha < 8.95), alpha
    assert destabilising_alpha(plant, drifts[1]) == pytest.approx(8.95, abs=0.01)


def test_a_sliding_mode_chatters_by_its_sign_alone() -> None:
    assert calm_share(np.sign) < 0.1
    assert calm_share(lambda s: float(np.tanh(100.0 * s))) == 1.0


def test_the_printed_riccati_gain_stabilises_and_that_of_the_poles_does_not() -> None:
    plant = linear_matrices(example_as_printed(1.0).plant)
    for L, pole in ((L_PRINTED, -2.44), (L_POLES, 0.024)):
        K = paper_riccati(plant.A - np.reshape(L, (2, 1)) @ plant.C, plant.B, ALPHA, np.eye(2)).K
        poles = np.linalg.eigvals(plant.A - plant.B @ K).real
        assert poles.max() == pytest.approx(pole, abs=5e-3)


def test_the_paper_s_sign_of_d_l_is_judged_too(paper: Paper) -> None:
    claims = {claim.text.id: claim for claim in paper.claims}
    for name in ("decomposition", "width-bound"):
        assert claims[name].printed["with d_l < 0"] <= claims[name].text.limit
        assert claims[name].printed["with d_l > 0"] > claims[name].text.limit
        assert claims[name].verdict == "holds after repair"


def test_measures_see_what_they_should(five: Run) -> None:
    n = five.t.size
    exact = dataclasses.replace(
        five, x_hat=five.x, z_hat=five.z, d_hat=np.ones((n, 2)), z_inverse=five.y + five.side
    )
    assert measures.reading_error(exact) < 1e-15
    assert measures.width_error(exact) == measures.steep_ratio(exact) == 0.0
    assert measures.inverse_error(exact) < 1e-15
    assert measures.total_inverse_error(exact) > 0.1  # inside the zone the inverse is blind
    biased = dataclasses.replace(
        exact, d_hat=exact.d_hat + np.array([0.25, 0.0]), x_hat=five.x + np.array([0.0, 0.5])
    )
    assert measures.width_error(biased) == 0.25
    assert measures.second_state_error(biased) == pytest.approx(0.5)
    dying = dataclasses.replace(five, d_hat=1.0 + np.exp(-0.3 * five.t)[:, None] * [1.0, -0.5])
    assert measures.width_convergence_rate(dying) == pytest.approx(0.3, rel=1e-3)
    gone = dataclasses.replace(five, d_hat=five.d_hat * 1e30)
    assert np.isinf(measures.worst_value(measures.width_error, [five, gone]))
    blown = dataclasses.replace(five, d_hat=np.exp(five.t)[:, None] * [1.0, 1.0])
    assert measures.growth_of_widths(blown) > 100.0
    assert measures.growth_of_widths(dying) <= 1.0


def test_the_gains_that_place_the_poles_have_no_pole_error() -> None:
    linear = linear_matrices(example_as_printed(1.0).plant)
    assert pole_error(linear, L_POLES) < 1e-12
    assert pole_error(linear, L_PRINTED) > 1.0


def test_operations_of_controllers_are_counted() -> None:
    """Of u_ff - K (x^ - x_ref): two products and two sums for x^, two differences, two more."""
    repaired = example_as_repaired(5.0)
    assert controller_operations(repaired) == 8
    for table in TABLES["controllers"].values():
        law = CONTROLLERS.decode_options(table)
        count = controller_operations(msgspec.structs.replace(repaired, controller=law))
        assert 8 < count < 1000


def test_outside_the_zone_42_moves_the_error_as_long_as_the_observer_lacks_B_u() -> None:
    """By eigenvalues of the whole loop, x and x~ with y' - y^' itself, for one alpha."""
    A, B, C = plant = linear_matrices(example_as_printed(1.0).plant)
    L = np.reshape(L_PRINTED, (2, 1))
    k_p, k_d = paper_riccati(A - L @ C, B, 3.0, np.eye(2)).K[0]
    feedback = -k_p * C - k_d * C @ (A - L @ C)
    whole = np.block([[A, B @ feedback], [np.zeros((2, 2)), A - L @ C + B @ feedback]])
    assert innovation_loop_pole(plant, 3.0) <= np.linalg.eigvals(whole).real.max() + 1e-9 <= 0.0


def test_operations_of_observers_are_counted() -> None:
    assert 0 < observer_operations(example_as_printed(5.0)) < 1000
    assert 0 < observer_operations(example_as_repaired(5.0)) < 1000


@pytest.mark.parametrize(
    ("words", "letters"),
    [
        ("reading y", "reading y"),
        ("error x^1 - x1", "error x\u0302\u2081 - x\u2081"),
        ("widths d^, y^", "widths d\u0302, \u0177"),
    ],
)
def test_letters_in_titles(words: str, letters: str) -> None:
    assert add_hats(words) == letters


def test_every_equation_is_placed_where_something_is() -> None:
    assert [equation.number for equation in EQUATIONS] == list(range(1, 43))
    for equation in EQUATIONS:
        assert equation.status in ("as printed", "corrected", "not used")
        assert equation.reason
        module, _, name = equation.where.rpartition(".")
        assert hasattr(importlib.import_module(module), name), equation.where


def test_progress_is_reported_of_work_done(paper: Paper) -> None:
    progress = once.audit()[1]
    assert sum(progress) > len(paper.variants) * DURATION / STEP
    assert min(progress) > 0


def test_files_are_all_there_and_hold_the_numbers(paper: Paper, written: list[Path]) -> None:
    names = {path.name for path in written}
    for number in FIGURES:
        assert {f"figure_{number}.svg", f"figure_{number}_2sin.svg"} <= names
    assert {f"{name}{end}.svg" for name in ("tracking", "V") for end in ("", "_2sin")} <= names
    assert {"figure_1.svg", "figure_2.svg", "theorem.svg"} <= names
    assert {"paper.json", "variants.csv", "report.html", "silence.svg"} <= names
    assert {path.name for path in written[0].parent.iterdir()} == names
    for path in written:
        assert path.suffix != ".svg" or path.read_bytes().startswith(b"<?xml")
    stored = json.loads((written[0].parent / "paper.json").read_text(encoding="utf-8"))
    assert stored == json.loads(json.dumps(paper.summary()))
    assert {"id", "words", "claim", "measured", "verdict"} <= set(stored["claims"][0])
    assert {"number", "where", "status", "printed", "claims"} <= set(stored["equations"][0])
    assert {"paper", "ours", "key", "c"} <= set(stored["letters"][0])
    assert {"theorem", "arm"} <= set(stored)
    page = (written[0].parent / "report.html").read_text(encoding="utf-8")
    for text in read_claim_texts():
        assert f"<code>{text.id}</code>" in page
    with open(written[0].parent / "variants.csv", newline="", encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == len(paper.variants)


def test_without_figures_only_numbers_are_written(paper: Paper, tmp_path: Path) -> None:
    written = write(paper, tmp_path, figures=False)
    assert {path.name for path in written} == {"paper.json", "variants.csv"}
    assert {path.name for path in tmp_path.iterdir()} == {"paper.json", "variants.csv"}


def test_nothing_is_drawn_before_it_is_requested() -> None:
    code = "import sys, undeadzone_paper; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
