"""docs/signal.md as it stands: its scenario watches a day, is exported, and the C agrees."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

import undeadzone as uz
from commands import undeadzone
from documents import DOCS, EXAMPLES
from undeadzone_export.compiler import require_compiler

DAY = 86_400  # samples
MAIN = """#include <stdio.h>
#include <stdlib.h>
#include "%(name)s.h"
int main(void)
{
    static %(name)s_state state;
    %(name)s_in in;
    %(name)s_out out;
    char text[64];
    %(name)s_init(&state);
    while (scanf("%%63s", text) == 1) {
        in.y[0] = atof(text);
        %(name)s_step(&state, &in, &out);
        printf("%%.17g,%%.17g,%%.17g,%%g\\n", out.z[0], out.low[0], out.high[0], out.quality[0]);
    }
    return 0;
}
"""


def flow(seed: int, samples: int) -> np.ndarray:
    """Return the flow of a pump that starts and stops, with drift, along a pipe of 8 s."""
    rng = np.random.default_rng(seed)
    goal = np.zeros(samples)
    at = 0
    while at < samples:
        hold = int(rng.exponential(600)) + 1
        goal[at : at + hold] = 0.0 if rng.random() < 0.3 else rng.uniform(0, 80)
        at += hold
    drift = lfilter([1e-3], [1.0, -0.99], rng.standard_normal(samples))
    return np.asarray(lfilter([0.12], [1.0, -0.88], goal * (1 + drift)))


def cut_off(z: np.ndarray, seed: int, edge: float = 2.0, noise: float = 0.3) -> np.ndarray:
    noisy = z + noise * np.random.default_rng(seed).standard_normal(z.size)
    return np.where(noisy > edge, noisy, 0.0)


def page_scenario(folder: Path) -> Path:
    text = re.search(r"```toml\n(.*?)```", (DOCS / "signal.md").read_text(), re.S)
    assert text is not None
    path = folder / "flow.toml"
    path.write_text(f'title = "Flow"\n{text[1]}')
    return path


def log_of(y: np.ndarray, first: int = 0) -> str:
    lines = [f"{first + k},{'' if np.isnan(one) else repr(float(one))}" for k, one in enumerate(y)]
    return "\n".join(["t,y", *lines, ""])


def watched(scenario: Path, text: str, *options: object) -> dict[str, np.ndarray]:
    done = undeadzone("watch", scenario, *options, stdin=text)
    assert done.returncode == 0, done.stderr
    assert "alarm" not in done.stderr
    names, *rows = done.stdout.splitlines()
    table = np.array([[float(entry) for entry in row.split(",")] for row in rows])
    return dict(zip(names.split(","), table.T, strict=True))


def test_a_day_of_flow_is_closer_than_its_readings_and_no_alarm(tmp_path: Path) -> None:
    z = flow(1, DAY)
    y = cut_off(z, 2)
    lost = np.random.default_rng(3).random(DAY) < 0.01
    found = watched(page_scenario(tmp_path), log_of(np.where(lost, np.nan, y)))
    outside = (y > 0) & ~lost
    for hour in np.split(np.arange(DAY), 24):
        here = hour[outside[hour]]
        error, plain = ((one - z)[here] for one in (found["z_hat[0]"], y))
        assert np.sqrt(np.mean(error**2)) < 0.7 * np.sqrt(np.mean(plain**2))
    error, plain = (np.abs(one - z)[outside].max() for one in (found["z_hat[0]"], y))
    assert error < plain
    assert abs(found["z_hat[0]"].sum() / z.sum() - 1) < 1e-3
    assert (found["z_hat[0]"][y == 0] == 0)[~lost[y == 0]].all()
    assert (found["quality[0]"][lost] == 0).all()
    held = (found["z_low[0]"] <= z) & (z <= found["z_high[0]"])
    assert held[~lost].mean() > 0.92
    assert found["noise[0]"][-1] / 0.3 < 1.1


def test_a_watch_goes_on_from_its_state(tmp_path: Path) -> None:
    scenario = page_scenario(tmp_path)
    y = cut_off(flow(4, 2000), 5)
    whole = watched(scenario, log_of(y))
    state = ("--state", tmp_path / "state.npz")
    watched(scenario, log_of(y[:1000]), *state)
    rest = watched(scenario, log_of(y[1000:], 1000), *state)
    assert np.array_equal(rest["z_hat[0]"], whole["z_hat[0]"][1000:])


def test_an_edge_that_moved_inward_raises_the_alarm(tmp_path: Path) -> None:
    z = flow(6, 20_000) / 10
    y = np.concatenate([cut_off(z, 7, noise=0.05), cut_off(z, 7, 0.5, 0.05)])
    scenario = page_scenario(tmp_path)
    scenario.write_text(scenario.read_text().replace("0.3 ", "0.05 "))
    done = undeadzone("watch", scenario, stdin=log_of(y))
    assert done.returncode == 1
    alarms = re.findall(r"alarm: readings do not fit, t = ([\d.]+)", done.stderr)
    assert alarms
    assert min(map(float, alarms)) > 20_000
    assert "widen observer.right" in done.stderr


def test_exported_c_gives_the_numbers_of_watch(tmp_path: Path) -> None:
    scenario = page_scenario(tmp_path)
    y = cut_off(flow(8, 3000), 9)
    y[100:120] = np.nan
    found = watched(scenario, log_of(y))
    done = undeadzone("export", scenario, "--out", tmp_path / "c", "--precision", "double")
    assert done.returncode == 0, done.stderr
    source = re.search(r"(\S+/(\w+)\.c)$", done.stdout, re.M)
    assert source is not None
    main = tmp_path / "main.c"
    main.write_text(MAIN % {"name": source[2]})
    words = [require_compiler(), "-O2", "-std=c99", "-ffp-contract=off", f"-I{tmp_path / 'c'}"]
    subprocess.run([*words, "-o", tmp_path / "run", main, source[1], "-lm"], check=True)
    text = "\n".join(map(repr, y.tolist()))
    run = subprocess.run([tmp_path / "run"], input=text, capture_output=True, text=True, check=True)
    table = np.array([[float(entry) for entry in row.split(",")] for row in run.stdout.split()])
    for name, column in zip(("z_hat", "z_low", "z_high", "quality"), table.T, strict=True):
        np.testing.assert_allclose(column, found[f"{name}[0]"], rtol=0, atol=1e-10)


def test_the_snippet_of_a_stick_adds_its_edge(tmp_path: Path) -> None:
    scenario = EXAMPLES / "signals" / "joystick.toml"
    done = undeadzone("export", scenario, "--check", "--out", tmp_path / "c")
    assert "every bit agrees" in done.stdout, done.stderr
    done = undeadzone("export", scenario, "--to", "snippet", "--out", tmp_path / "s")
    assert done.returncode == 0, done.stderr
    names: dict[str, object] = {}
    exec((tmp_path / "s" / "snippet.py").read_text(), names)
    undead = names["undead"]
    assert callable(undead)
    assert [undead(y) for y in (0.1, 0.0, -0.2)] == [0.22, 0.0, -0.32]


def test_a_signal_has_no_loop() -> None:
    done = undeadzone("run", EXAMPLES / "signals" / "joystick.toml")
    assert done.returncode == 2
    assert "a signal has no input, so there is no loop to run" in done.stderr
    assert uz.read(EXAMPLES / "signals" / "joystick.toml").plant.kind == "signal"
