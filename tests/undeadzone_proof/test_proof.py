"""Proofs of a scenario, changes that are refused, an export whose C is changed by one bit."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from benchmarks.design.proofs import attack, is_refused, mutants, random_scenario

import undeadzone as uz
import undeadzone_proof
from commands import undeadzone
from undeadzone.errors import InputError, ProofError
from undeadzone_proof.source import Code, Refused
from undeadzone_proof.theorem import hold_exactly

SOURCES = Path(undeadzone_proof.__file__).parents[1]


@pytest.mark.parametrize("k", [24, 25, 37])
def test_each_change_of_a_proof_is_refused(k: int, tmp_path: Path) -> None:
    uz.prove(random_scenario(0, k), tmp_path / "proof.json")
    proof = undeadzone_proof.to_numbers(json.loads((tmp_path / "proof.json").read_text()))
    assert proof["statement"] == undeadzone_proof.verify_proof(proof)
    every = mutants(proof)
    assert len(every) >= 20
    assert all(map(is_refused, every))
    if "set" in proof:
        found = attack(proof, 60, k)
        assert found.left == 0
        assert 0 < found.seen < proof["set"]["radius"] < 10 * found.seen


@pytest.mark.parametrize("precision", ["single", "double"])
def test_one_bit_of_an_exported_constant_breaks_its_proof(precision: str, tmp_path: Path) -> None:
    scenario = random_scenario(0, 37)
    assert uz.check(scenario).summary()["certified"]
    report = uz.export(scenario, out=tmp_path, name="own", precision=precision).report
    # Without installed packages, so that the checker needs the standard library alone.
    run = [sys.executable, "-S", "-m", "undeadzone_proof", str(tmp_path / "proof.json")]
    check = partial(subprocess.run, run, capture_output=True, text=True, cwd=SOURCES)
    done = check()
    assert (done.returncode, done.stdout.strip()) == (0, report["proof"])
    code, text = tmp_path / "own.c", (tmp_path / "own.c").read_text()
    real = np.float32 if precision == "single" else np.float64
    number = max(re.findall(r"\d\.\d+", text), key=len)
    near = str(np.nextafter(real(number), real(1)))
    for old, new, step in (
        (number, near, "operations: those of the C"),
        ("right_was_0 + ", "right_was_0 - ", "operations: those of the C"),
        ("left[0] = 0.0", "left[0] = -1.0", "start: widths in their range"),
        ("#include", "#define x\n#include", "source: no foreign macros"),
        ("FP_CONTRACT OFF", "FP_CONTRACT ON", "source: arithmetic is as written"),
    ):
        code.write_text(text.replace(old, new))
        done = check()
        assert (done.returncode, done.stdout.strip()) == (1, f"refused: {step}")
    assert undeadzone_proof.main([]) == undeadzone_proof.main(["no.json"]) == 1


@pytest.mark.parametrize(("text", "bits"), [("0.1", 53), ("0.1f", 24), ("1e-45f", 24)])
def test_a_literal_is_what_a_compiler_makes_of_it(text: str, bits: int) -> None:
    code = Code.__new__(Code)
    code.bits, code.least = bits, {53: 1074, 24: 149}[bits]
    number = (np.float32 if text.endswith("f") else np.float64)(text.removesuffix("f"))
    assert code.read_literal(text) == Fraction(float(number))
    with pytest.raises(Refused):
        code.read_literal("0.1f" if bits == 53 else "0.1")


def test_the_exponential_is_close() -> None:
    A = [[Fraction(-3), Fraction(1)], [Fraction(0), Fraction(-3)]]
    plant = {"A": A, "B": [[Fraction(0)], [Fraction(1)]], "Ts": Fraction(1, 2)}
    rows = np.array(hold_exactly(plant), float)
    e = np.exp(-1.5)
    exact = [[e, 0.5 * e, (1 - 2.5 * e) / 9], [0, e, (1 - e) / 3]]
    assert rows == pytest.approx(np.array(exact), rel=1e-14)


def test_what_the_theorem_does_not_have_is_named(tmp_path: Path) -> None:
    scenario = random_scenario(0, 37)
    for key, error, words in (
        ({"width_max": None}, InputError, "needs observer.width_max"),
        ({"silence": True}, ProofError, "source"),
        ({"L": [[-500.0]]}, ProofError, "not positive real"),
    ):
        with pytest.raises(error, match=words):
            uz.prove(scenario | {"observer": key}, tmp_path / "p.json")
    assert not (tmp_path / "p.json").exists()


def test_check_writes_a_proof(tmp_path: Path) -> None:
    example = Path(__file__).parents[2] / "examples" / "paper_5sin.toml"
    done = undeadzone("check", example, "--no-figures", "--proof", tmp_path / "proof.json")
    assert "a V that falls" in done.stdout
    assert undeadzone_proof.main([str(tmp_path / "proof.json")]) == 0
