"""A control loop about 45 % and 310 K: log in, scenario, estimates, live samples and C out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import undeadzone as uz
from commands import undeadzone
from further import further
from undeadzone.errors import InputError, ShapeError
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import parse
from undeadzone.simulation.exogenous import targets
from undeadzone.simulation.follower import Follower
from undeadzone.simulation.log_diagnosis import what_would_fit
from undeadzone.util.arrays import Floats
from undeadzone_design.synthesis.check import check
from undeadzone_export.accuracy import CompiledStep
from undeadzone_export.code import build_code
from undeadzone_export.exported_step import build_step, field_slices

OP, PV = 45.0, 310.0  # at rest [%, K]
GAP = 6.0  # of the valve's play [%]
EDGES = 42.0, 47.0  # between which a valve does nothing [%]
POINT = "[operating_point]\ninput = [45.0]\noutput = [310.0]\n"
PLANT = """
title = "heater"
[plant]
A = [[-0.1]]
B = [[0.2]]
C = [[1.0]]
[sensor]
right = 1.0
left = 0.6
noise = 0.05
[reference]
kind = "sine"
amplitude = 5.0
frequency = 0.01
[observer]
method = "censored"
right = [0.0, 2.0]
left = [0.0, 2.0]
disturbance = 0.1
[simulation]
duration = 300.0
time = "sampled"
step = 1.0
[units]
output = "K"
input = "%"
"""


def loop(fault: str, seed: int) -> dict[str, Floats]:
    """OP, PV, SP and z of a PI loop of a lag behind a valve, 2000 samples of a second."""
    rng = np.random.default_rng(seed)
    sp = np.repeat(PV + rng.uniform(-6, 6, 20), 100)
    z = integral = 0.0
    valve = OP
    rows = []
    for k in range(sp.size):
        y = PV + z + 0.15 * rng.standard_normal()
        integral += 0.06 * (sp[k] - y)
        op = OP + integral + 0.5 * (sp[k] - y)
        rows.append((op, y, sp[k], PV + z))
        if fault == "play":
            valve = min(max(valve, op - GAP / 2), op + GAP / 2)
            moved = valve - OP
        else:
            moved = max(op - EDGES[1], 0.0) + min(op - EDGES[0], 0.0)
        z = 0.9 * z + 0.2 * moved
    return dict(zip(("OP", "PV", "SP", "z"), np.array(rows).T, strict=True))


def save(log: dict[str, Floats], path: Path) -> Path:
    """Write the log of a loop as its historian does."""
    table = np.column_stack([np.arange(log["OP"].size), log["OP"], log["PV"], log["SP"]])
    header = "t [s],OP [%],PV [K],SP [K]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    return path


@pytest.fixture(scope="module", params=["zone", *further("play")])
def identified(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The fault, and the folder with the scenario that one log of its loop leads to."""
    folder = tmp_path_factory.mktemp(request.param)
    log = save(loop(request.param, 1), folder / "loop.csv")
    options = ["--zero", PV, "--chain", "fw"] if request.param == "zone" else []
    done = undeadzone("identify", log, *options, "--order", 1, "--no-figures", cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return request.param, folder, done.stdout


def test_the_scenario_of_a_loop_counts_from_its_levels(identified: Any) -> None:
    fault, folder, words = identified
    scenario = uz.read(folder / "loop.toml")
    (u,), (z,) = scenario.operating_point.input, scenario.operating_point.output
    if fault == "play":  # any input at rest serves, with the output that belongs to it
        assert abs(z - PV - 2 * (u - OP)) < 0.3
        assert abs(scenario.actuator.right + scenario.actuator.left - GAP) < 0.3
        return
    edges = u - scenario.actuator.left, u + scenario.actuator.right
    assert np.abs(np.subtract(edges, EDGES)).max() < 0.1
    text = (folder / "loop.toml").read_text()
    assert f"nothing happens between {edges[0]:.6g} and {edges[1]:.6g}" in text
    assert f"nothing happens between {edges[0]:.4f}" in words


def test_the_estimate_along_another_log_of_the_loop_is_consistent(identified: Any) -> None:
    fault, folder, _ = identified
    log = loop(fault, 2)
    fresh = save(log, folder / "fresh.csv")
    out = folder / "estimate"
    done = undeadzone("estimate", folder / "loop.toml", fresh, "--out", out, "--no-figures")
    assert done.returncode == 0, done.stdout
    found = uz.Estimation.load(out / "estimate.npz")
    error = found.z_hat[:, 0] - log["z"]
    assert np.mean(np.abs(error) < 1.96 * found.x_std[:, 0]) > 0.9
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean((log["PV"] - log["z"]) ** 2))
    text = (folder / "loop.toml").read_text()
    head, rest = text.split("[operating_point]")
    at_zero = parse(head + rest[rest.index("[sensor]") :])
    assert uz.estimate(at_zero, fresh, smoothing=False).consistent is False


def test_live_samples_and_c_give_the_numbers_of_the_estimate(
    identified: Any, tmp_path: Path
) -> None:
    fault, folder, _ = identified
    log = save(loop(fault, 3), tmp_path / "live.csv")
    scenario = uz.read(folder / "loop.toml")
    found = uz.estimate(scenario, log, smoothing=False)
    done = undeadzone("watch", "--json", folder / "loop.toml", stdin=log.read_bytes())
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert np.array_equal([row["z_hat"] for row in rows], found.z_hat)
    step = build_step(resolve_scenario(scenario))
    out = CompiledStep(build_code(step, single=False), tmp_path)(np.hstack([found.y, found.u]))
    z = out[:, field_slices(step.outputs)["z"]]
    assert np.abs(z - found.z_hat).max() < 1e-9


def test_a_log_leads_to_firmware_in_the_units_of_its_plant(identified: Any) -> None:
    fault, _, words = identified
    if fault == "zone":
        off = next(line for line in words.splitlines() if line.startswith("firmware off"))
        assert float(off.split("rms z^ - z ")[1].split()[0]) < 0.1


# --- A scenario that was written by hand


def test_a_run_is_reported_in_the_units_of_its_plant(tmp_path: Path) -> None:
    (tmp_path / "heater.toml").write_text(PLANT + POINT)
    assert undeadzone("run", "heater.toml", "--out", "o", "--csv", cwd=tmp_path).returncode == 0
    run, plain = uz.Run.load(tmp_path / "o" / "run.csv"), uz.simulate(parse(PLANT))
    for name, level in {"z": PV, "y": PV, "z_hat": PV, "r": PV, "u": OP, "x": 0.0}.items():
        assert np.abs(getattr(run, name) - getattr(plain, name) - level).max() < 1e-9, name
    assert np.array_equal(run.d_hat, plain.d_hat)
    done = undeadzone("estimate", "heater.toml", "o/run.csv", "--out", "e", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    smooth = uz.Estimation.load(tmp_path / "e" / "estimate.npz").z_smooth
    assert smooth is not None
    assert np.abs(smooth - run.z).max() < 2.0


def test_a_law_in_python_gets_and_gives_the_units_of_the_plant() -> None:
    seen = []

    def law(t: float, estimate: uz.Estimate, r: Floats) -> Floats:
        seen.append((estimate.z[0], r[0]))
        return OP + 2 * (r - estimate.z)

    run = uz.simulate(parse(PLANT + POINT), controller=law)
    assert np.array_equal(np.array(seen), np.column_stack([run.z_hat, run.r]))
    assert np.allclose(run.u, OP + 2 * (run.r - run.z_hat), atol=1e-9)


@pytest.mark.parametrize("part", ["observer+controller", *further("observer")])
def test_exported_c_takes_and_gives_the_units_of_the_plant(part: str, tmp_path: Path) -> None:
    scenario = parse(PLANT + POINT)
    firmware = uz.export(scenario, "c", tmp_path / "fw", "double", part=part, check=True)
    assert firmware.has_passed
    step = build_step(resolve_scenario(scenario), part)
    run = uz.simulate(scenario)
    given = {"y": run.y, "u": run.u, "r": run.r}
    if part != "observer":
        plain = resolve_scenario(parse(PLANT))
        target = targets(plain, run.t)
        given |= {"x_ref": target.x_ref, "u_ff": target.u_ff + OP}
    rows = np.hstack([given[field.name] for field in step.inputs])
    out = CompiledStep(build_code(step, single=False), tmp_path)(rows)
    of = field_slices(step.outputs)
    assert np.abs(out[:, of["z"]] - run.z_hat).max() < 1e-9
    if part != "observer":
        assert np.abs(out[:, of["u"]] - run.u).max() < 1e-9


def test_a_point_at_0_changes_no_bit() -> None:
    zero = POINT.replace("45.0", "0.0").replace("310.0", "0.0")
    problems = [resolve_scenario(parse(text)) for text in (PLANT, PLANT + zero)]
    one, other = (build_step(problem).function.serialize() for problem in problems)
    assert one == other
    first, second = (uz.simulate(parse(text)) for text in (PLANT, PLANT + zero))
    assert all(np.array_equal(first.signals.arrays[name], second.signals.arrays[name],
                              equal_nan=True) for name in first.signals.arrays)  # fmt: skip
    assert Follower(parse(PLANT)).digest == Follower(parse(PLANT + zero)).digest


def test_a_saved_state_belongs_to_its_operating_point(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(PLANT + POINT)
    (tmp_path / "b.toml").write_text(PLANT + POINT.replace("45.0", "44.0"))
    lines = b"t,y,u\n0,310.5,45\n1,311.5,45\n"
    words = ["watch", "--state", tmp_path / "kept"]
    assert undeadzone(*words, tmp_path / "a.toml", stdin=lines).returncode == 0
    assert undeadzone(*words, tmp_path / "b.toml", stdin=lines).returncode == 2


def test_the_other_sign_is_found_about_the_point() -> None:
    run = uz.simulate(parse(PLANT + POINT))
    scenario = parse(PLANT + POINT)
    found = uz.estimate(scenario, t=run.t, y=run.y, u=2 * OP - run.u)
    assert found.consistent is False
    assert "other sign" in (what_would_fit(scenario, found) or "")


def test_what_no_point_can_have_is_refused(tmp_path: Path) -> None:
    matrices = "A = [[-0.1]]\nB = [[0.2]]\nC = [[1.0]]"
    formulas = 'states = ["a"]\ninputs = ["v"]\nf = ["v - a"]\nh = ["a"]'
    pendulum = PLANT.replace(matrices, formulas)
    with pytest.raises(InputError, match="operating_point: needs a linear plant"):
        resolve_scenario(parse(pendulum + POINT))
    with pytest.raises(ShapeError, match=r"operating_point\.output: expected 1 number"):
        resolve_scenario(parse(PLANT + POINT.replace("[310.0]", "[310.0, 20.0]")))
    (tmp_path / "heater.toml").write_text(PLANT + POINT)
    done = undeadzone("export", "heater.toml", "--to", "snippet", "--out", "s", cwd=tmp_path)
    assert done.returncode == 0
    assert "310" in (tmp_path / "s/snippet.h").read_text()


def test_check_of_an_unknown_actuator_is_about_the_point() -> None:
    """Its branches are those of a run in deviations, as without the point."""
    zone = "[actuator]\nright = 0.3\nleft = 0.2\n[model.actuator]\nright = [0, 1]\nleft = [0, 1]\n"
    one, other = (check(parse(PLANT + zone + point)) for point in ("", POINT))
    assert one.summary() == other.summary()
