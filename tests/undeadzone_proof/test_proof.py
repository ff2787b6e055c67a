"""Proofs of a scenario, changes that are refused, the bound of rounding beside rounding itself."""

from __future__ import annotations

import json
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from benchmarks.design.proofs import attack, is_refused, mutants, random_scenario

import undeadzone as uz
import undeadzone_proof
from commands import undeadzone
from undeadzone.errors import InputError, ProofError
from undeadzone_proof.exact import Refused, hold_exactly
from undeadzone_proof.source import Code


@pytest.mark.parametrize("k", [24, 25, 37])
def test_each_change_of_a_proof_is_refused(k: int, tmp_path: Path) -> None:
    uz.prove(random_scenario(0, k), tmp_path / "proof.json")
    proof = undeadzone_proof.to_numbers(json.loads((tmp_path / "proof.json").read_text()))
    assert proof["statement"] == undeadzone_proof.verify_proof(proof)
    every = mutants(proof)
    assert len(every) >= 20
    assert all(map(is_refused, every))
    for one in proof.get("sets", []):
        found = attack(proof, one, 60, 100, k)
        assert found.left == 0
        assert 0 < found.seen < one["radius"]


def test_an_export_has_its_proof_and_one_bit_of_its_code_breaks_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "firmware"
    report = uz.export(random_scenario(0, 37), out=out, name="own", precision="single").report
    assert undeadzone_proof.main([str(out / "proof.json")]) == 0
    assert capsys.readouterr().out.strip() == report["proof"]
    code = out / "own.c"
    for old, new in (("right_was_0 + ", "right_was_0 - "), ("#include", "#define x\n#include")):
        text = code.read_text()
        code.write_text(text.replace(old, new))
        assert undeadzone_proof.main([str(out / "proof.json")]) == 1
        assert capsys.readouterr().out.startswith("refused: ")
        code.write_text(text)
    assert undeadzone_proof.main([]) == undeadzone_proof.main(["no.json"]) == 1


def test_the_checker_needs_the_standard_library_alone() -> None:
    texts = [path.read_text() for path in Path(undeadzone_proof.__file__).parent.glob("*.py")]
    lines = [line.split() for text in texts for line in text.splitlines()]
    named = {line[1].split(".")[0] for line in lines if line[:1] in (["import"], ["from"])}
    assert named - {"undeadzone_proof", "__future__"} <= sys.stdlib_module_names
    assert max(text.count("\n") for text in texts) < 300


@pytest.mark.parametrize(
    ("text", "kind"), [("0.1", "double"), ("0.1f", "float"), ("1e-45f", "float")]
)
def test_a_literal_is_what_a_compiler_makes_of_it(text: str, kind: str) -> None:
    code = Code.__new__(Code)
    code.bits, code.least, code.suffix = {"double": (53, 1074, ""), "float": (24, 149, "f")}[kind]
    number = (np.float32 if text.endswith("f") else np.float64)(text.removesuffix("f"))
    assert code.make_number(text).low == Fraction(float(number))
    with pytest.raises(Refused):
        code.make_number("0.1f" if kind == "double" else "0.1")


def test_the_exponential_is_within_its_bound() -> None:
    A = [[Fraction(-3), Fraction(1)], [Fraction(0), Fraction(-3)]]
    exact, held, lost = hold_exactly(A, [[Fraction(0)], [Fraction(1)]], Fraction(1, 2))
    assert float(exact[0][1]) == pytest.approx(0.5 * np.exp(-1.5), rel=1e-15)
    assert float(held[1][0]) == pytest.approx((1 - np.exp(-1.5)) / 3, rel=1e-15)
    assert 0 < lost < Fraction(1, 1 << 140)


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
