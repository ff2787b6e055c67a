"""Automatic design: searches with known answers, gains against naive twins, the paper, files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import once
from scenes import COUPLED, scene, table
from undeadzone.analysis.certificate.design_file import STATED, Design
from undeadzone.analysis.certificate.passivity import certify
from undeadzone.analysis.convergence.floquet import error_decay_rates, error_matrices
from undeadzone.analysis.error_dynamics import adaptation_matrix
from undeadzone.errors import (
    FileError,
    InputError,
    ProofError,
    ShapeError,
    UndeadzoneError,
)
from undeadzone.feedforward.targets import linear_targets
from undeadzone.numerics.optimise import find_pareto_front, is_undominated, minimise_by_cmaes
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.simulation.simulate import simulate
from undeadzone.util.arrays import Floats
from undeadzone_design.synthesis.check import check
from undeadzone_design.synthesis.design import count_design_rounds, design
from undeadzone_design.synthesis.gain_search import Weights
from undeadzone_design.synthesis.task import (
    add_frequencies,
    build_task,
    score_candidate,
    shrink_to_certified,
)

SAMPLED = {"time": "sampled", "step": 1e-2}


@pytest.fixture(scope="module")
def knee() -> Design:
    return once.design(scene())


@pytest.fixture(scope="module")
def quickest() -> Design:
    return once.design(scene(), "rate")


def test_evolve_finds_the_bottom_of_a_curved_valley() -> None:
    def rosenbrock(x: Floats) -> Floats:
        return np.asarray(
            (100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2).sum(axis=1)
        )

    low, high = np.full(4, -3.0), np.full(4, 3.0)
    x, cost = minimise_by_cmaes(rosenbrock, low, high, seed=1, size=32, rounds=400)
    assert cost < 1e-8
    assert x == pytest.approx(np.ones(4), abs=1e-3)
    near, _ = minimise_by_cmaes(
        lambda x: ((x - 5.0) ** 2).sum(axis=1), low, high, seed=1, size=16, rounds=200
    )
    assert near == pytest.approx(high)


def test_pareto_finds_a_front_that_is_known() -> None:
    """Distances to two points: the front is the segment between them, without what is refused."""

    def costs(x: Floats) -> Floats:
        found = np.stack([((x - 1.0) ** 2).sum(axis=1), ((x + 1.0) ** 2).sum(axis=1)], axis=1)
        return np.where(x[:, :1] < 0.9, found, np.inf)

    points, found = find_pareto_front(
        costs, np.full(3, -3.0), np.full(3, 3.0), seed=0, starts=np.zeros((1, 3)), divisions=40
    )
    assert len(points) >= 30
    assert is_undominated(found).all()
    assert (points[:, 0] < 0.9).all()
    assert np.sqrt(found).sum(axis=1) == pytest.approx(2 * np.sqrt(3), rel=5e-3)
    assert [points[:, 1].min(), points[:, 1].max()] == pytest.approx([-1.0, 1.0], abs=0.1)


def naive(scenario: Any) -> tuple[Floats, Floats]:
    """(rms from unit noise, rms from unit relative errors in A and B), step by step.

    The errors are those of the entries -1, -2 and 1; the error system is sampled.
    """
    problem = resolve_scenario(scenario)
    (A, B, C), Ts = problem.model.linear, scenario.simulation.step
    N = round(1 / Ts)
    z = problem.reference.output_at(np.arange(N) * Ts)
    sides = np.where(np.abs(z) > 1, np.sign(z), 0.0)
    L, gamma = (
        problem.observer.params.L / Ts,
        adaptation_matrix(problem.observer.params.gamma / Ts, 1),
    )
    F, G = error_matrices((A - np.eye(2)) / Ts, C, L, gamma, sides)
    Phi, G = np.eye(4) + Ts * F, Ts * G
    Z = np.block([[C, np.zeros((1, 2))], [np.zeros((2, 2)), np.eye(2)]])
    target = linear_targets(problem.model, problem.reference, [0], np.arange(N) * Ts)
    # u held for a step moves x by Bd u: the same input B carries the errors of this companion
    # plant.
    forces = [-target.x_ref[:, 0], -2 * target.x_ref[:, 1], target.u_ff[:, 0]]
    total, covariance, x = 0.0, np.zeros((4, 4)), np.zeros((3, 4))
    pushed = np.zeros(3)
    for _ in range(60):
        total, pushed = 0.0, np.zeros(3)
        for k in range(N):
            total += np.trace(Z @ covariance @ Z.T)
            pushed += ((x @ Z.T) ** 2).sum(axis=1)
            covariance = Phi[k] @ covariance @ Phi[k].T + G[k] @ G[k].T
            x = x @ Phi[k].T + np.array(
                [np.concatenate([B[:, 0] * force[k], [0.0, 0.0]]) for force in forces]
            )
    return np.sqrt(total / N), np.sqrt(pushed.sum() / N)


def test_gains_are_those_of_a_step_by_step_simulation() -> None:
    scenario = scene(simulation=SAMPLED)
    problem = resolve_scenario(scenario)
    found = score_candidate(build_task(problem, 0.01), np.array([[1.0], [1.5]]), np.array([10.0]))
    noise, mismatch = naive(scenario)
    assert found.noise == pytest.approx(noise, rel=1e-9)
    assert found.mismatch == pytest.approx(mismatch, rel=1e-6)
    assert found.rate == pytest.approx(
        error_decay_rates(
            problem.model.linear, found.L, found.gamma, build_task(problem, 0.01).schedule
        ).rate,
        rel=1e-12,
    )


def test_noise_gain_is_what_a_noisy_run_shows() -> None:
    """rms of (z - z^, d - d^) over a long run with small white noise and no false alarm.

    It agrees within the scatter of the run's finite length.
    """
    noise = 1e-3
    scenario = scene(
        sensor={"noise": noise, "false_alarm_rate": 1e-9},
        simulation=SAMPLED | {"duration": 400.0, "seed": 3},
    )
    run = simulate(scenario)
    late = run.t > 20
    error = np.hstack([run.z - run.z_hat, run.info.widths - run.d_hat])[late]
    gain = score_candidate(
        build_task(resolve_scenario(scenario), 0.01), np.array([[1.0], [1.5]]), np.array([10.0])
    ).noise
    assert np.sqrt((error**2).sum(axis=1).mean()) == pytest.approx(gain * noise, rel=0.05)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        COUPLED,
        {"reference": {"kind": "trapezoid", "amplitude": 3.0, "rise": 0.5, "hold": 0.53}},
    ],
)
def test_sampled_gains_tend_to_the_continuous_ones(changes: dict[str, Any]) -> None:
    values = []
    for simulation in ({"step": 1e-3}, {"time": "sampled", "step": 1e-3}):
        problem = resolve_scenario(scene(**changes, simulation=simulation))
        per_second = 1.0 if problem.model.Ts is None else 1e3
        found = score_candidate(
            build_task(problem, 0.01),
            problem.observer.params.L * per_second,
            problem.observer.params.gamma * per_second,
        )
        values.append([found.rate, found.disturbance, found.mismatch, found.noise])
    assert values[0] == pytest.approx(values[1], rel=0.02)


@pytest.mark.parametrize(
    "changes", [{}, {"simulation": SAMPLED}, COUPLED, COUPLED | {"simulation": SAMPLED}]
)
def test_shrunk_gains_meet_the_margin_and_no_more(changes: dict[str, Any]) -> None:
    """Random gains, shrunk until certified, with their own worst frequencies looked at.

    The exact margin is the one asked for.
    """
    rng = np.random.default_rng(0)
    problem = resolve_scenario(scene(**changes))
    task = build_task(problem, 0.05)
    L, gamma, W = (
        rng.normal(size=(10, task.n, task.p)) * 5,
        rng.uniform(0.1, 20.0, (10, task.p)),
        np.ones((10, task.p)),
    )
    for _ in range(3):
        shrunk = shrink_to_certified(task, L, gamma, W)
        proofs = [
            certify(problem.model.linear, task.units[:, None] * one, speed, problem.model.Ts)
            for one, speed in zip(shrunk, gamma, strict=True)
        ]
        task = add_frequencies(
            task, np.array([proof.frequency for proof in proofs if proof.frequency is not None])
        )
    for before, after, proof in zip(L, shrunk, proofs, strict=True):
        assert proof.certified
        assert proof.margin > 0.05 * (1 - 1e-3)
        assert task.p > 1 or np.allclose(before, after) or proof.margin < 0.05 * (1 + 1e-6)


def test_the_fastest_certified_gains_of_the_paper_example(quickest: Design) -> None:
    assert quickest.best.rate >= 1.45
    assert quickest.margin >= 0.01 * (1 - 1e-6)
    proof = certify(quickest.model, quickest.L, quickest.gamma)
    assert proof.certified
    assert proof.margin == pytest.approx(quickest.margin, rel=1e-6)
    judged = check(
        scene(observer={"method": "certified", "L": quickest.best.L, "gamma": quickest.best.gamma})
    )
    assert judged.rate == pytest.approx(quickest.best.rate, rel=1e-6)


def test_the_knee_beats_the_present_gains_in_everything(knee: Design) -> None:
    assert knee.present is not None
    assert knee.best.rate > knee.present.rate * 1.04
    assert knee.best.disturbance < knee.present.disturbance / 1.04
    assert knee.best.noise < knee.present.noise / 1.04
    assert knee.remarks == []
    assert knee.margin >= 0.01 * (1 - 1e-6)


def test_gains_near_the_present_ones_that_beat_them_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Third order, default L: what is better in everything lies in a narrow valley.

    The front's search passes it by, a short one as well as a long one.
    """
    once.in_haste(monkeypatch)
    third = scene("""
        plant = { companion = [6.0, 11.0, 6.0] }
        observer = { method = "certified", gamma = 5.0 }
        reference = { kind = "sine", amplitude = 2.0, frequency = 0.4 }
        """)
    found = design(third)
    assert found.present is not None
    assert found.remarks == []
    assert found.best.rate > found.present.rate
    assert found.best.disturbance < found.present.disturbance
    assert found.best.noise < found.present.noise


def test_every_point_of_the_front_is_certified_and_undominated(knee: Design) -> None:
    costs = np.array([[-point.rate, point.disturbance, point.noise] for point in knee.front])
    assert len(costs) > 20
    assert is_undominated(costs).all()
    assert (np.diff(costs[:, 0]) >= 0).all()
    assert max(point.rate for point in knee.front) > 1.45
    for point in knee.front:
        proof = certify(knee.model, np.array(point.L), np.array(point.gamma))
        assert proof.certified
        assert proof.margin > 0.01 * (1 - 1e-3)


def test_a_design_is_reproducible_and_tells_its_rounds(quickest: Design) -> None:
    progress: list[int] = []
    assert design(scene(), "rate", progress=progress.append) == quickest
    assert sum(progress) == count_design_rounds("rate") < count_design_rounds("knee")


def test_incompatible_aims_are_reported(quickest: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing beats the fastest gains in rate, however long one searches."""
    once.in_haste(monkeypatch)
    again = design(
        scene(observer={"method": "certified", "L": quickest.best.L, "gamma": quickest.best.gamma})
    )
    (remark,) = again.remarks
    assert "at once" in remark
    assert "rate" in remark.partition("these lose in")[2]


def test_weights_move_the_trade(quickest: Design, monkeypatch: pytest.MonkeyPatch) -> None:
    once.in_haste(monkeypatch)
    quiet = once.design(scene(), Weights(noise=1.5))
    assert quiet.chosen == "rate / (disturbance^0 mismatch^0 noise^1.5)"
    assert quiet.best.noise < quickest.best.noise
    assert quiet.best.rate < quickest.best.rate
    assert np.log(quiet.best.rate) - 1.5 * np.log(quiet.best.noise) > np.log(
        quickest.best.rate
    ) - 1.5 * np.log(quickest.best.noise)


def test_several_outputs_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    once.in_haste(monkeypatch)
    found = design(scene(**COUPLED, simulation=SAMPLED), "rate")
    assert found.Ts == 1e-2
    assert found.present is not None
    assert found.best.rate > 1.5 * found.present.rate
    assert certify(found.model, found.L, found.gamma, found.Ts).margin >= 0.01 * (1 - 1e-6)


def test_an_edge_that_is_not_reached_is_left_out_and_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    once.in_haste(monkeypatch)
    found = design(
        scene(reference={"kind": "sine", "amplitude": 2.0, "frequency": 1.0, "offset": 2.0}), "rate"
    )
    assert found.never == ["left[0]"]
    assert found.identifiable[0].right
    assert not found.identifiable[0].left
    assert found.identifiable[0].std["left"] == np.inf
    assert "times as large" in found.identifiable[0].cures[0]
    assert found.best.rate > 0.5


@pytest.mark.parametrize("margin", [0.0, 1.0, -0.1])
def test_margins_without_sense(margin: float) -> None:
    with pytest.raises(InputError, match="margin: must lie between 0 and 1"):
        design(scene(), "rate", margin=margin)


def test_the_requested_margin_is_met() -> None:
    assert once.design(scene(), "rate", margin=0.3).margin == pytest.approx(0.3, rel=1e-6)


def test_a_design_is_saved_exactly(knee: Design, tmp_path: Path) -> None:
    loaded = Design.load(knee.save(tmp_path / "knee.toml"))
    assert loaded == msgspec.structs.replace(knee, remarks=[*knee.remarks, STATED])
    assert Design.load(loaded.save(tmp_path / "again.toml")) == loaded


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"margin": 0.9}, ProofError, "margin: 0.9 in the file, its gains have 0.01"),
        ({"margin": float("nan")}, ProofError, "margin: nan in the file"),
        ({"Ts": -0.001}, InputError, "Ts: expected a sample time above 0 s, found -0.001"),
        ({"Ts": 0.0}, InputError, "Ts: expected a sample time"),
        ({"states": [True]}, ShapeError, "states: expected 2 entries, found 1"),
        ({"identifiable": []}, ShapeError, "identifiable: expected 1 entries, found 0"),
        ({"K": [[1.0]]}, ShapeError, "K: expected"),
    ],
)
def test_what_a_design_states_is_recomputed(
    quickest: Design, tmp_path: Path, change: dict[str, Any], error: type[Exception], words: str
) -> None:
    path = msgspec.structs.replace(quickest, **change).save(tmp_path / "design.toml")
    with pytest.raises(error, match=words):
        Design.load(path)


def test_present_gains_of_a_design_are_certified_again(knee: Design, tmp_path: Path) -> None:
    assert knee.present is not None
    present = msgspec.structs.replace(knee.present, L=[[12.0], [15.0]])
    path = msgspec.structs.replace(knee, present=present).save(tmp_path / "design.toml")
    with pytest.raises(ProofError, match="present: the file lists these gains as certified"):
        Design.load(path)


def test_what_cannot_be_recomputed_is_named(quickest: Design, tmp_path: Path) -> None:
    best = msgspec.structs.replace(quickest.best, rate=1e9)
    edited = msgspec.structs.replace(quickest, best=best, frequency=1e9)
    loaded = Design.load(edited.save(tmp_path / "design.toml"))
    assert loaded.frequency == quickest.frequency
    assert "not recomputed: K, rate" in loaded.remarks[-1]


def test_a_p_that_is_not_symmetric_is_no_proof_of_a_design(
    quickest: Design, tmp_path: Path
) -> None:
    # An unstable spiral, "proved" by I + J: x'Px holds the symmetric part of P alone.
    forged = msgspec.structs.replace(
        quickest,
        A=[[0.1, 1.0], [-1.0, 0.1]],
        P=[[1.0, 1.0], [-1.0, 1.0]],
        W=[1e-2],
        best=msgspec.structs.replace(quickest.best, L=[[1e-3], [1e-3]], gamma=[1e-3]),
    )
    with pytest.raises(ProofError, match="its proof does not hold"):
        Design.load(forged.save(tmp_path / "design.toml"))


@pytest.mark.parametrize(
    "change",
    [
        {"P": [[1.0, 0.0], [0.0, 1.0]]},
        {"W": [1.3]},
        {"A": [[0.0, 1.0], [-0.8, -2.0]]},
        {"best": [[-0.9], [0.7]]},
    ],
)
def test_a_changed_design_is_refused(
    quickest: Design, tmp_path: Path, change: dict[str, Any]
) -> None:
    if "best" in change:
        change = {"best": msgspec.structs.replace(quickest.best, L=change["best"])}
    path = msgspec.structs.replace(quickest, **change).save(tmp_path / "design.toml")
    with pytest.raises(ProofError, match="its proof does not hold"):
        Design.load(path)


def test_a_design_in_a_scenario(quickest: Design, tmp_path: Path) -> None:
    quickest.save(tmp_path / "gains.toml")
    by_file = convert(table(observer={"method": "certified", "design": "gains.toml"}), tmp_path)
    by_hand = scene(
        observer={"method": "certified", "L": quickest.best.L, "gamma": quickest.best.gamma}
    )
    assert (simulate(by_file).x_hat == simulate(by_hand).x_hat).all()
    assert check(by_file).certified


def test_a_design_of_ragged_numbers_is_refused(quickest: Design, tmp_path: Path) -> None:
    path = msgspec.structs.replace(quickest, P=[[1.0, 0.0], [1.0]]).save(tmp_path / "design.toml")
    with pytest.raises(InputError, match="P: expected numbers in a rectangular list"):
        Design.load(path)


@pytest.mark.parametrize(
    ("observer", "changes", "error", "words"),
    [
        ({"L": [1.0, 1.0]}, {}, InputError, "observer.design: it brings L and gamma"),
        ({"gamma": 1.0}, {}, InputError, "observer.design: it brings L and gamma"),
        (
            {},
            {"plant": {"companion": [1.0, 3.0, 3.0]}},
            ProofError,
            "the design is for 2 states and 1 outputs, the model has 3 and 1",
        ),
        (
            {},
            {"plant": {"companion": [1.0, 0.3]}},
            ProofError,
            "its proof does not hold.*made for another model",
        ),
        (
            {},
            {"simulation": {"time": "sampled", "step": 0.1}},
            ProofError,
            "its proof does not hold.*sample time",
        ),
        ({"design": "none.toml"}, {}, FileError, "none.toml: cannot read"),
        ({"design": "other.toml"}, {}, FileError, "other.toml: not a design saved by undeadzone"),
    ],
)
def test_a_design_that_does_not_fit(
    quickest: Design,
    tmp_path: Path,
    observer: dict[str, Any],
    changes: dict[str, Any],
    error: type[UndeadzoneError],
    words: str,
) -> None:
    quickest.save(tmp_path / "gains.toml")
    (tmp_path / "other.toml").write_text("title = 'a scenario'\n")
    with pytest.raises(error, match=words):
        simulate(
            convert(
                table(
                    observer={"method": "certified", "design": "gains.toml"} | observer, **changes
                ),
                tmp_path,
            )
        )


def test_check_of_the_paper_example() -> None:
    gains = (([12.0, 15.0], 2.0), ([1.0, 1.5], 10.0), ([2.0, 3.0], 10.0))
    verdicts = [
        check(scene(observer={"method": "certified", "L": L, "gamma": gamma})).summary()
        for L, gamma in gains
    ]
    assert [found["certified"] for found in verdicts] == [False, True, True]
    assert [found["rate"] for found in verdicts] == pytest.approx([0.024, 0.441, 0.323], abs=6e-4)
    assert (verdicts[0]["margin"], verdicts[0]["frequency"]) == (
        pytest.approx(-0.0417, abs=1e-4),
        pytest.approx(2.49, abs=1e-2),
    )
    assert verdicts[1]["identifiable"] == {
        "right": True,
        "left": True,
        "width": True,
        "centre": True,
    }
    assert (verdicts[1]["reasons"], verdicts[0]["reasons"][0][:13]) == ([], "not certified")


def test_check_of_what_has_no_certificate() -> None:
    found = check(scene(observer={"method": "luenberger", "poles": [-4.0, -10.0]})).summary()
    assert (found["certified"], found["rate"]) == (None, None)
    assert found["identifiable"]["centre"]
    force = check(
        scene("""
            controller = { method = "pd", k_p = 1.0, k_d = 1.0 }
            simulation = { duration = 4.0 }
            """)
    ).summary()
    assert not force["identifiable"]["right"]
    assert "never reached" in force["reasons"][0]
    both = check(scene(**COUPLED)).summary()
    assert [part["width"] for part in both["identifiable"]] == [True, True]
    biased = check(scene(disturbance={"kind": "step", "amplitude": 0.5})).summary()
    assert (biased["identifiable"]["centre"], biased["std"]["centre"]) == (False, None)
    assert "calibrate the input" in biased["cures"][0]
    assert biased["states"] == [False, True]
    growing = check(
        scene(observer={"method": "certified", "L": [-2000.0, 0.0], "gamma": 1.0})
    ).summary()
    assert growing["rate"] is None
    assert "the error grows along the reference" in growing["reasons"]


def test_a_slow_plant_needs_no_fast_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """A time constant of ten thousand seconds, a step of a hundred.

    What `Certified` assumes by default is not in the way.
    """
    once.in_haste(monkeypatch)
    slow = scene("""
        plant = { A = [[-0.0001]], B = [[0.0001]], C = [[1.0]] }
        reference = { kind = "sine", amplitude = 5.0, frequency = 1e-5 }
        observer = { method = "kalman", right = [0.0, 3.0] }
        controller = { method = "state_feedback", alpha = 1.0 }
        simulation = { duration = 1000000.0, step = 100.0 }
        """)
    assert design(slow, "rate").best.rate > 1e-5
