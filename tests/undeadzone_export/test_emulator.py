"""The exported C on an emulated Cortex-M4F: the bits of this computer, instructions, stack."""

from __future__ import annotations

import functools
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from test_engines import OBSERVERS, small

import undeadzone as uz
from requirements import require
from scenes import scene
from undeadzone.scenario.schema import Scenario
from undeadzone_export import boards, compiler, exporting

HERE = Path(__file__).parents[1] / "emulator"
TOOLS = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi, libnewlib-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
}
CORE = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
FLAGS = ["-O2", "-std=c99", "-fno-math-errno", "-ffunction-sections", "-fdata-sections"]
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror"]
CASES = ("certified", "censored", "extended")


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip by the names of Debian's packages; fail where UNDEADZONE_REQUIRE names the emulator."""
    monkeypatch.setattr(exporting, "STEPS", 600)
    unmeasured = {"accuracy": None, "stack": None, "refusals": []}  # it is measured elsewhere
    monkeypatch.setattr(exporting, "_accuracy_report", lambda *_: dict(unmeasured))
    require("emulator", [package for tool, package in TOOLS.items() if shutil.which(tool) is None])


def case(name: str) -> Scenario:
    if name == "certified":
        return scene(simulation={"time": "sampled"})
    return small("sampled", observer={"method": name} | OBSERVERS[name][1])


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """The folder of a case in a precision, which is exported once."""

    @functools.cache
    def folder(name: str, precision: str) -> Path:
        out = tmp_path_factory.mktemp(f"{name}-{precision}") / "fw"
        uz.export(case(name), out=out, precision=precision, name="o")
        return out

    return folder


@pytest.fixture(scope="module")
def compiled(exported: Callable[[str, str], Path]) -> Callable[[str], Path]:
    """The object of a case in float, optimised and without a warning, which is made once."""

    @functools.cache
    def target(name: str) -> Path:
        folder = exported(name, "single")
        options = [*CORE, *FLAGS, *WARNINGS, "-ffp-contract=off", "-c", "-o", str(folder / "o.o")]
        subprocess.run(["arm-none-eabi-gcc", *options, str(folder / "o.c")], check=True)
        return folder / "o.o"

    return target


def emulated(
    folder: Path, build_folder: Path, sources: list[Path], options: list[str]
) -> subprocess.CompletedProcess[str]:
    """A program for the M4 of the code in a folder, made elsewhere and run in the emulator."""
    program = build_folder / "program.elf"
    link = ["-T", str(HERE / "memory.ld"), "-nostartfiles", "--specs=rdimon.specs"]
    files = [str(HERE / "start.c"), *map(str, sources)]
    command = ["arm-none-eabi-gcc", *CORE, *FLAGS, *options, "-I", str(folder), *link]
    command += ["-Wl,--gc-sections", "-o", str(program), *files, "-lm"]
    subprocess.run(command, check=True)
    board = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-icount", "shift=0",
             "-semihosting-config", "enable=on,target=native", "-kernel", str(program)]  # fmt: skip
    return subprocess.run(
        board, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=120
    )


EVERY = [(name, precision) for name in CASES for precision in exporting.PRECISIONS]


@pytest.mark.parametrize(("name", "precision"), EVERY)
def test_the_same_bits_as_on_this_computer(
    name: str,
    precision: str,
    exported: Callable[[str, str], Path],
    compiled: Callable[[str], Path],
    tmp_path: Path,
) -> None:
    """The self-test holds the bits; on the M4 it must pass as it does here.

    Double is software there, and its code of no effort: optimised, it takes long to compile.
    """
    folder = exported(name, precision)
    effort = ["-O0"] if precision == "double" else []
    code = folder / "o.c" if precision == "double" else compiled(name)
    sources = [code, folder / "o_test.c"]
    result = emulated(folder, tmp_path, sources, ["-ffp-contract=off", *effort])
    if (result.returncode, "every bit agrees" in result.stdout) == (0, True):
        return
    assert precision == "double", result.stdout  # and there a - b alone explains it
    printed = emulated(folder, tmp_path, [HERE / "subtract.c"], ["-ffp-contract=off"]).stdout
    assert printed.strip() == "off in the last bit", result.stdout


def test_options_of_an_IDE_that_would_contract_change_nothing(
    exported: Callable[[str, str], Path], tmp_path: Path
) -> None:
    folder = exported("extended", "single")
    sources = [folder / "o.c", folder / "o_test.c"]
    result = emulated(folder, tmp_path, sources, ["-std=gnu11", "-Os", "-ffp-contract=fast"])
    assert (result.returncode, "every bit agrees" in result.stdout) == (0, True), result.stdout


# Ceilings, 10 % above what was measured: instructions of a step (not cycles: the emulator knows no
# wait states) with the loop that calls it, and bytes of stack. Scores of claims take 76 bytes of
# the smallest `extended`, which has 352.
COUNTED = {"certified": (132, 100), "censored": (22_500, 1_480), "extended": (4_230, 387)}


@pytest.mark.parametrize("name", CASES)
def test_instructions_stack_warnings_and_libraries(
    name: str,
    exported: Callable[[str, str], Path],
    compiled: Callable[[str], Path],
    tmp_path: Path,
) -> None:
    folder, target = exported(name, "single"), compiled(name)
    nm = ["arm-none-eabi-nm", "-u", str(target)]
    assert subprocess.run(nm, capture_output=True, text=True, check=True).stdout == ""
    result = emulated(folder, tmp_path, [target, HERE / "count.c"], [])
    counts = re.fullmatch(r"mean (\d+) most (\d+) stack (\d+)\s*", result.stdout)
    assert counts, result.stdout + result.stderr
    mean, most, stack = map(int, counts.groups())
    instructions, bytes_of_stack = COUNTED[name]
    assert most >= mean
    assert most <= instructions, (mean, most, stack)
    assert stack <= bytes_of_stack, (mean, most, stack)


def test_make_size_tells_the_flash_of_a_cortex_m4f(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the report has the same."""
    monkeypatch.setattr(boards, "object_bytes", compiler.object_bytes)
    exported = exporting.export(case("certified"), "c", tmp_path / "fw", "single", name="joint")
    (fit,) = [each for each in exported.report["boards"] if "M4F" in each["board"]]
    done = subprocess.run(
        ["make", "-s", "size"], cwd=tmp_path / "fw", capture_output=True, text=True, check=True
    )
    heads, values = done.stdout.strip().split("\n")
    sizes = dict(zip(heads.split(), values.split(), strict=True))
    assert 100 < int(sizes["text"]) < 5000
    assert fit["measured"]
    assert int(sizes["text"]) == fit["flash"]
    assert sizes["data"] == sizes["bss"] == "0"
    assert sizes["filename"] == "joint_target.o"
    assert "make size" in (tmp_path / "fw" / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", CASES)
def test_the_flash_of_a_board_is_that_of_its_object(
    name: str, exported: Callable[[str, str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within 10 % of what its compiler makes at -Os, wherever that is installed."""
    monkeypatch.setattr(boards, "object_bytes", compiler.object_bytes)
    folder = exported(name, "single")
    report = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    sources = [folder / each for each in report["files"] if re.fullmatch(r"o(_math)?\.[ch]", each)]
    files = tuple((path.name, path.read_text(encoding="utf-8")) for path in sources)
    measured = set()
    for board, fit in zip(boards.BOARDS, boards.fit_boards(report, files), strict=True):
        gcc, *chip = board.compiler.split()
        if not fit.measured:
            assert shutil.which(gcc) is None or fit.flash >= boards.HOPELESS * board.flash
            continue
        options = [*chip, "-std=c99", "-Os", "-ffp-contract=off", "-ffunction-sections"]
        subprocess.run([gcc, *options, "-c", "-o", "o.o", folder / "o.c"], cwd=tmp_path, check=True)
        sizes = subprocess.run(
            [gcc.replace("gcc", "size"), "o.o"],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        text, data = map(int, sizes.splitlines()[1].split()[:2])
        assert fit.flash == pytest.approx(text + data, rel=0.1)
        measured.add(board.name)
    assert {"Cortex-M0+ (SAMD21)", "Cortex-M4F (STM32F4)"} <= measured
    rows = boards.board_table(boards.fit_boards(report, files))
    assert [row[0] for row in rows if row[1].endswith("kB")] == sorted(
        measured, key=[board.name for board in boards.BOARDS].index
    )
