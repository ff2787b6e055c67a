"""The command line, as a user meets it: outputs, exit codes, one clear line for every mistake."""

from __future__ import annotations

import io
import json
import platform
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest

from commands import COMMAND, undeadzone
from documents import EXAMPLES
from undeadzone.cli import group
from undeadzone.results.run import Run
from undeadzone.util import progress
from undeadzone_export import exporting
from undeadzone_identify.command import identify


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    assert undeadzone("init", "--full", tmp_path / "mine.toml").returncode == 0
    path = tmp_path / "mine.toml"
    path.write_text(path.read_text().replace("duration = 20.0 ", "duration = 6.0 "))
    return path


@pytest.fixture
def certified(scenario: Path) -> Path:
    """The template with the alternative that has a proof, in continuous time."""
    text = scenario.read_text()
    for old, new in (
        ('method = "auto" ', "# "),
        ("right = [0.0, 2.0] ", "# "),
        ("disturbance = 0.2 ", "# "),
        ("bias = 0.0 ", "# "),
        ('# method = "certified"', 'method = "certified"'),
        ("# L = [1.0, 1.5] ", "L = [1.0, 1.5] "),
        ("# gamma = 10.0 ", "gamma = 10.0 "),
        ('time = "sampled" ', 'time = "continuous" '),
        ("step = 0.01 ", "step = 1e-3 "),
        ("noise = 0.01 ", "noise = 0.0 "),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    scenario.write_text(text)
    return scenario


def test_version_and_help() -> None:
    assert re.fullmatch(r"undeadzone, version \d+\.\d+\.\d+\n", undeadzone("--version").stdout)
    assert undeadzone("-V").stdout == undeadzone("--version").stdout
    for command in ([], ["run"], ["paper"], ["init"], ["watch"]):
        done = undeadzone(*command, "--help")
        assert done.returncode == 0
        assert "undeadzone" in done.stdout
        assert "Example" in done.stdout or command == []
    listed = undeadzone("--help").stdout
    names = group.list_commands(click.Context(group))
    assert len(names) > len(group.commands)
    assert [name for name in names if f"\n  {name} " not in listed] == []
    assert undeadzone("help").stdout == listed
    assert undeadzone("help", "watch").stdout == undeadzone("watch", "--help").stdout
    assert undeadzone("help", "wacth").returncode == 2


def test_the_bare_command_prints_its_help() -> None:
    bare, full = undeadzone(), undeadzone("--help")
    assert bare.returncode == full.returncode == 0
    first = re.findall(r"^  (\w+) [\[A-Z]", bare.stdout, re.MULTILINE)
    assert first == ["init", "run", "identify", "export"]
    for name in re.split(r",\s+", bare.stdout.split("--help:\n")[1].strip()):
        assert re.search(rf"^  {name}\b", full.stdout, re.MULTILINE)
        assert name not in first
    assert not bare.stderr


def test_the_short_template_has_25_lines_and_runs_as_the_full_one(tmp_path: Path) -> None:
    for name, words in (("short", []), ("full", ["--full"])):
        assert undeadzone("init", tmp_path / f"{name}.toml", *words).returncode == 0
    short = (tmp_path / "short.toml").read_text()
    lines = [line for line in short.split("\n") if line and not line.startswith("#")]
    assert len(lines) == 25
    texts = [tomllib.loads((tmp_path / f"{name}.toml").read_text()) for name in ("short", "full")]
    assert texts[0] == texts[1]


def test_a_rare_option_stands_in_the_whole_help_alone() -> None:
    usual, whole = (
        undeadzone("identify", "--help").stdout,
        undeadzone("identify", "--help-all").stdout,
    )
    assert "--integrators" not in usual
    options = [line for line in usual.splitlines() if line.startswith("  -")]
    assert len(options) == 6 + 2  # besides --help-all and --help
    listed = [name for names in identify.subjects.values() for name in names]
    assert len(listed) == len(set(listed)) == len(identify.get_params(click.Context(identify))) - 1
    assert {line.split()[0] for line in usual.splitlines() if line.startswith("  --")} <= set(
        whole.split()
    )
    every = [each for each in identify.params if isinstance(each, click.Option)]
    assert [each.name for each in every if not each.help or each.opts[0] not in whole] == []


@pytest.mark.parametrize(("option", "code"), [("--version", 0), ("--nonsense", 2)])
def test_the_package_runs_as_the_command_does(option: str, code: int) -> None:
    module = subprocess.run(
        [sys.executable, "-m", "undeadzone", option], capture_output=True, text=True, check=False
    )
    command = undeadzone(option)
    assert module.returncode == command.returncode == code
    assert module.stdout == command.stdout
    assert module.stderr.partition(": ")[2] == command.stderr.partition(": ")[2]


def test_help_imports_nothing_heavy() -> None:
    heavy = ("numpy", "casadi", "scipy", "llvmlite", "matplotlib", "rich")
    code = (
        "import sys\nfrom undeadzone.cli import group\n"
        "group.main(['--help'], standalone_mode=False)\n"
        f"print([m for m in {heavy} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "paper" in done.stdout
    assert done.stderr == "[]\n"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc gives pages back")
def test_a_command_keeps_the_memory_that_it_frees() -> None:
    """Arrays that come and go take pages once, not each time."""
    code = (
        "import resource, sys\nimport numpy as np\n"
        "from undeadzone.cli import _retain_freed_memory\n"
        "if 'keep' in sys.argv: _retain_freed_memory()\n"
        "for _ in range(40): [np.ones(10_000) for _ in range(200)]\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)"
    )
    faults = [
        int(
            subprocess.run(
                [sys.executable, "-c", code, how], capture_output=True, check=True
            ).stdout
        )
        for how in ("keep", "give back")
    ]
    assert faults[0] < faults[1] / 3


def test_numpy_names_all_that_it_has_after_the_import_of_scipy() -> None:
    code = (
        "import numpy as np\nbefore = np.__all__, dir(np)\n"
        "from undeadzone.cli.output import Output\nOutput(None, True, False).choose_folder('x')\n"
        "import scipy.linalg\nassert before == (np.__all__, dir(np))\nassert np.f2py, np.random"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_run_imports_no_more_than_it_needs(scenario: Path) -> None:
    code = (
        "import sys\nfrom undeadzone.cli import group\n"
        f"group.main(['run', {str(scenario)!r}, '--no-figures', '--json'], standalone_mode=False)\n"
        "heavy = 'matplotlib', 'rich', 'scipy.signal', 'pandas', 'numpy.f2py', 'numpy.testing'\n"
        "print([m for m in heavy if m in sys.modules], file=sys.stderr)"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stderr
        == "[]\n"
    )


def test_run_json_is_one_object_and_writes_nothing_unasked(scenario: Path) -> None:
    done = undeadzone("run", scenario, "--json", "--no-figures", cwd=scenario.parent)
    assert done.returncode == 0
    assert done.stderr == ""
    result = json.loads(done.stdout)
    assert {
        "rms_tracking",
        "rms_estimation",
        "d_right",
        "d_left",
        "silent_fraction",
        "seconds",
    } <= set(result)
    assert 0 < result["rms_tracking"] < 1
    assert sorted(path.name for path in scenario.parent.iterdir()) == ["mine.toml"]
    tables = undeadzone("run", scenario, "--no-figures", "--csv", cwd=scenario.parent)
    assert tables.returncode == 0
    names = sorted(path.name for path in (scenario.parent / "mine-results").iterdir())
    assert names == ["run.csv", "run.npz"]


def test_run_writes_signals_figure_and_page(scenario: Path) -> None:
    out = scenario.parent / "deep" / "results"
    done = undeadzone("run", scenario, "--out", out)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in out.iterdir()) == [
        "figure.svg",
        "report.html",
        "run.csv",
        "run.npz",
    ]
    run = Run.load(out / "run.npz")
    np.testing.assert_array_equal(Run.load(out / "run.csv").z, run.z)
    page = (out / "report.html").read_text()
    assert not re.search(r"(src|href)=[\"']https?:", page)
    assert (out / "figure.svg").read_bytes().startswith(b"<?xml")


def test_init_does_not_overwrite(scenario: Path) -> None:
    before = scenario.read_text()
    done = undeadzone("init", scenario)
    assert (done.returncode, scenario.read_text()) == (2, before)
    assert "--force" in done.stderr
    assert undeadzone("init", scenario, "--force").returncode == 0


def test_integrators_are_answered_with_no(tmp_path: Path) -> None:
    done = undeadzone("run", EXAMPLES / "integrators.toml", "--no-figures")
    assert done.returncode == 1
    assert "centre is not identifiable" in done.stdout
    assert "only the width" in done.stdout


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("right = 1.0 ", "rigth = 1.0 ", ["sensor.rigth", "unknown key", "right"]),
        ("right = 1.0 ", "", ["sensor.right", "missing"]),
        ("right = 1.0 ", "right = -1.0 ", ["sensor.right", "negative", "-1"]),
        ("right = 1.0 ", "right = nan ", ["sensor.right", "finite"]),
        ("right = 1.0 ", 'right = "wide" ', ["sensor.right", "wide"]),
        ("right = 1.0 ", "right = [1.0, 2.0] ", ["sensor.right", "expected 1", "found 2"]),
        ("B = [[0.0], [1.0]]", "B = [[0.0], [1.0], [2.0]]", ["plant.B", "2 rows", "found 3 x 1"]),
        (
            "A = [[0.0, 1.0], [-1.0, -2.0]]",
            "A = [[0.0, 1.0], [-1.0]]",
            ["plant.A", "different lengths"],
        ),
        ("C = [[1.0, 0.0]] ", "C = [[0.0, 0.0]] ", ["(A, C)", "unobservable"]),
        ("B = [[0.0], [1.0]]", "B = [[0.0], [0.0]]", ["(A, B)", "uncontrollable"]),
        (
            "A = [[0.0, 1.0], [-1.0, -2.0]]",
            "A = [[0.0, 1.0], [1.0, -2.0]]\n# ",
            ["observer.L", "unstable"],
        ),
        ("step = 1e-3 ", "step = 0.5 ", ["simulation.step", "too coarse"]),
        ("duration = 6.0 ", "duration = 0.0 ", ["simulation.duration", "greater than 0"]),
        (
            'method = "certified"',
            'method = "certifed"',
            ["observer.method", "certifed", "certified"],
        ),
        ('kind = "sine"', 'kind = "csv"\npath = "no.csv"\n#', ["reference", "amplitude"]),
        ('title = "My plant"', "title = ", ["TOML"]),
    ],
)
def test_wrong_input_is_one_clear_line(
    certified: Path, old: str, new: str, words: list[str]
) -> None:
    text = certified.read_text()
    assert old in text
    certified.write_text(
        text.replace(old, new, 1).replace("L = [1.0, 1.5]", "L = [0.5, 0.0]")
        if "observer.L" in words
        else text.replace(old, new, 1)
    )
    done = undeadzone("run", certified, "--json")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1, done.stderr
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr


@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("run", []),
        ("check", []),
        ("design", []),
        ("ensemble", []),
        ("tune", ["--over", "observer.disturbance=0.1:1"]),
        ("estimate", [EXAMPLES / "samples.csv"]),
        ("watch", []),
        ("export", []),
    ],
)
def test_a_value_that_does_not_fit_is_named_with_its_file(
    scenario: Path, command: str, more: list[object]
) -> None:
    """The key was named alone, which of two files it stands in was not."""
    text = scenario.read_text().replace("noise = 0.01 ", "noise = -1.0 ", 1)
    scenario.write_text(text + "\n[ensemble]\nruns = 4\n")
    done = undeadzone(command, scenario, *more, cwd=scenario.parent)
    assert done.returncode == 2
    assert done.stderr.startswith(f"undeadzone: {scenario}: sensor.noise: "), done.stderr
    assert done.stderr.count("\n") == 1


def test_a_log_of_which_nothing_can_be_learnt_is_answered(tmp_path: Path) -> None:
    log = tmp_path / "short.csv"
    log.write_text("t,u,y\n0,0,0\n0.1,1,0\n0.2,1,0.1\n")
    done = undeadzone("identify", log, cwd=tmp_path)
    assert done.returncode == 1
    assert "No number can be given" in done.stdout
    assert "3 readings are too few. Order 1 needs 100" in done.stdout


@pytest.mark.parametrize(
    "words",
    [["run", "MINE", "--out", ""], ["export", "MINE", "--out", ""], ["run", ""], ["arena", ""]],
)
def test_an_empty_name_is_refused(scenario: Path, words: list[str]) -> None:
    """As a folder it was the one in which the command was started, and filled that."""
    before = sorted(scenario.parent.iterdir())
    named = [str(scenario) if word == "MINE" else word for word in words]
    done = undeadzone(*named, cwd=scenario.parent)
    assert done.returncode == 2
    assert "the name is empty. The folder in which you are is '.'" in done.stderr
    assert sorted(scenario.parent.iterdir()) == before


def test_a_design_says_that_other_methods_need_none(scenario: Path) -> None:
    """A filter helps the run, not the design: that it said so of one that has a filter was odd."""
    ranges = "right = [0.0, 1.0]\nleft = [0.0, 1.0]\n"
    text = scenario.read_text() + f"\n[actuator]\nright = 0.5\n\n[model.actuator]\n{ranges}"
    scenario.write_text(text)
    done = undeadzone("design", scenario, "--no-figures")
    assert done.returncode == 2
    assert "model.actuator.right: 'certified' cannot estimate" in done.stderr
    assert "A design is of 'certified' alone, others need none" in done.stderr


def test_reference_that_cannot_be_followed(certified: Path) -> None:
    text = certified.read_text()
    numerator, denominator = [1.0, 0.0, 1.5791367041742974], [1.0, 3.0, 3.0, 1.0]
    plant = f"transfer_function = {{ numerator = {numerator}, denominator = {denominator} }}\n"
    start = text.index("A = [[0.0")
    text = text[:start] + plant + "#" + text[text.index("# Other forms") :]
    certified.write_text(
        text.replace("L = [1.0, 1.5] ", "#").replace("Q = [[1.0, 0.0], [0.0, 1.0]]", "")
    )
    done = undeadzone("run", certified)
    assert done.returncode == 2
    assert "zero of the plant" in done.stderr
    assert "1.257j" in done.stderr


def test_out_is_a_file(scenario: Path) -> None:
    done = undeadzone("run", scenario, "--no-figures", "--out", scenario)
    assert done.returncode == 2
    assert "cannot write" in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "arguments", [["run", "--json", "--no-figures"], ["run", "--no-figures"], ["watch"]]
)
def test_a_full_stdout_is_one_line(scenario: Path, arguments: list[str]) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [*COMMAND, *arguments, str(scenario)],
            input="y,u\n0.5,1.0\n",
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "undeadzone: stdout: cannot write: No space left on device\n"


def test_an_observer_without_informative_readings_ends_with_a_no(scenario: Path) -> None:
    """Its widths stay what they were: no success; one that knows them learns nothing."""
    silent = re.sub(r"amplitude = .*", "amplitude = 0.1", scenario.read_text())
    scenario.write_text(re.sub(r"x0 = .*", "x0 = [0.0, 0.0]", silent))
    done = undeadzone("run", scenario, "--no-figures")
    assert done.returncode == 1
    assert "the right edge is never reached" in done.stdout


def test_usage_errors() -> None:
    for arguments, words in (
        (["rn"], "run"),
        (["run"], "SCENARIO.toml"),
        (["run", "a.toml", "--jsn"], "--json"),
    ):
        done = undeadzone(*arguments)
        assert done.returncode == 2
        assert words in done.stderr


def test_watch_answers_each_sample(scenario: Path) -> None:
    done = undeadzone("watch", scenario, stdin="y,u\n0.5,1.0\n,2.0\nnan,\n-0.2,0.0\n")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert lines[0].startswith("t,x_hat[0],x_hat[1],z_hat[0],d_right[0],d_left[0]")
    assert len(lines) == 5
    assert "4 samples, 2 missing" in done.stderr
    assert all(np.isfinite([float(cell) for cell in line.split(",")]).all() for line in lines[1:])


def test_watch_reads_the_log_of_the_examples() -> None:
    done = undeadzone(
        "watch", EXAMPLES / "asymmetric_noise.toml", stdin=(EXAMPLES / "samples.csv").read_text()
    )
    assert done.returncode == 0
    assert "400 samples, 4 missing" in done.stderr
    assert len(done.stdout.splitlines()) == 401


def test_watch_flushes_every_line(scenario: Path) -> None:
    with subprocess.Popen(
        [*COMMAND, "watch", str(scenario), "--json"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("y,u\n")
        for k in range(3):
            process.stdin.write(f"{0.1 * k},1.0\n")
            process.stdin.flush()
            assert json.loads(process.stdout.readline())["t"] == pytest.approx(k * 1e-2)
        process.stdin.close()
        assert process.wait(20) == 0


@pytest.mark.parametrize(
    ("stdin", "words"),
    [
        ("", "no samples"),
        ("y,u\n", "no samples"),
        ("1.0,2.0\n", "without a header"),
        ("t,y,u,y\n1,2,3,4\n", "the log has 2"),
        ("y,v\n1.0,2.0\n", "holds u"),
        ("1" * 200_000, "not CSV text"),
    ],
)
def test_watch_wrong_input(scenario: Path, stdin: str, words: str) -> None:
    done = undeadzone("watch", scenario, stdin=stdin)
    assert done.returncode == 2
    assert words in done.stderr


def test_init_writes_examples_with_their_files(tmp_path: Path) -> None:
    listed = undeadzone("init", "--list").stdout
    for path in EXAMPLES.glob("*.*"):
        name = path.stem if path.suffix in (".toml", ".urdf") else path.name
        assert f"\n{name} " in listed
    done = undeadzone("init", "--example", "ur5", "deep/mine.toml", "--out", "out", cwd=tmp_path)
    assert "next: undeadzone run out/deep/mine.toml" in done.stdout
    for name, written in (("ur5.toml", "mine.toml"), ("ur5.urdf", "ur5.urdf")):
        original = (EXAMPLES / name).read_bytes()
        assert (tmp_path / "out" / "deep" / written).read_bytes() == original


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--example", "two_lnk"], "Did you mean 'two_link'?"),
        (["--example", "../secret"], "--list shows their titles"),
        (["--example", ""], "--list shows their titles"),
    ],
)
def test_init_knows_no_other_example(words: list[str], expected: str, tmp_path: Path) -> None:
    done = undeadzone("init", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert expected in done.stderr
    assert not list(tmp_path.iterdir())


def test_init_replaces_no_file_of_an_example(tmp_path: Path) -> None:
    (tmp_path / "ur5.urdf").write_text("mine")
    done = undeadzone("init", "--example", "ur5", cwd=tmp_path)
    assert done.returncode == 2
    assert "ur5.urdf: exists already" in done.stderr
    assert not (tmp_path / "ur5.toml").exists()


class Terminal(io.StringIO):
    """A terminal that keeps what it shows."""

    def isatty(self) -> bool:
        return True


def patient_terminal(monkeypatch: pytest.MonkeyPatch, patience: float) -> Terminal:
    """The terminal that stderr is from now on, with a bar after so many seconds."""
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    monkeypatch.setattr(progress, "PATIENCE", patience)
    return shown


def wait_for_text(terminal: Terminal, word: str) -> bool:
    """Whether a terminal shows a word within seconds."""
    for _ in range(200):
        if word in terminal.getvalue():
            return True
        time.sleep(0.05)
    return False


def test_a_long_set_up_is_reported_before_the_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = patient_terminal(monkeypatch, 0.01)
    with progress.terminal_progress("simulating", 10) as advance:
        assert wait_for_text(terminal, "setting up")
        advance(4)
        advance(3)
        assert wait_for_text(terminal, "7/10")
        assert "simulating" in terminal.getvalue()


def test_an_early_step_is_reported_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the next one may take long."""
    terminal = patient_terminal(monkeypatch, 0.2)
    with progress.terminal_progress("simulating", 10) as advance:
        advance(4)
        assert wait_for_text(terminal, "4/10")


def test_a_short_command_shows_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = patient_terminal(monkeypatch, 60.0)
    with progress.terminal_progress("simulating", 10) as advance:
        advance(10)
    assert terminal.getvalue() == ""


SLOW = """title = "slow"
plant = { A = [[-1.0, 1.0], [0.0, -2.0]], B = [[0.0], [2.0]], C = [[1.0, 0.0]] }
sensor = { right = 0.4, left = 0.3, noise = 0.01 }
reference = { kind = "sine", amplitude = 2.0, frequency = 1.0 }
observer = { method = "kalman", right = [0.1, 1.0], left = [0.1, 1.0] }
controller = { method = "state_feedback", poles = [-6.0, -7.0] }
simulation = { duration = 0.2, step = 1e-2, time = "sampled" }
ensemble = { runs = 2, "sensor.right" = { uniform = [0.3, 0.5] } }
tune = { budget = 4, runs = 2, held_out = 2, "observer.noise" = { between = [0.1, 1.0] } }
"""


@pytest.mark.parametrize(
    "words",
    [
        ["run", "slow.toml", "--no-figures"],
        ["check", "slow.toml", "--no-figures"],
        ["estimate", "slow.toml", "log.csv", "--no-figures"],
        ["watch", "slow.toml"],
        ["ensemble", "slow.toml", "--no-figures"],
        ["tune", "slow.toml", "--no-figures"],
        ["export", "slow.toml"],
    ],
)
def test_every_command_says_what_it_sets_up(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Filters of high order, and of arms, take long before their first step."""
    log = "t,y,u\n0,0,0\n0.01,0,1\n0.02,0,1\n"
    (tmp_path / "slow.toml").write_text(SLOW)
    (tmp_path / "log.csv").write_text(log)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(log.encode())))
    terminal = patient_terminal(monkeypatch, 0.0)
    monkeypatch.delenv(progress.OF_KERNEL, raising=False)
    assert group.main(words, standalone_mode=False) in (0, 1)
    assert "setting up kalman" in terminal.getvalue()


@pytest.mark.parametrize("command", ["run", "check"])
def test_export_is_suggested_for_scenarios_that_it_accepts(command: str, tmp_path: Path) -> None:
    """Of a continuous scenario, and of an observer that knows the state, it is refused."""
    text = (EXAMPLES / "paper_2sin.toml").read_text()
    (tmp_path / "mine.toml").write_text(text)
    hint = 'undeadzone export mine.toml takes it with simulation.time = "sampled"'
    assert hint in undeadzone(command, "mine.toml", "--no-figures", cwd=tmp_path).stdout
    replaced = re.sub(r"(?s)\[observer\].*?\n\n", '[observer]\nmethod = "full_state"\n\n', text)
    (tmp_path / "mine.toml").write_text(replaced)
    done = undeadzone(command, "mine.toml", "--no-figures", cwd=tmp_path)
    assert done.returncode != 2, done.stderr
    assert "undeadzone export" not in done.stdout


def test_what_is_to_be_typed_next_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first command on, each that another names ends without a complaint."""
    monkeypatch.setattr(exporting, "STEPS", 2000)
    assert undeadzone("init", "mine.toml", cwd=tmp_path).returncode == 0
    waiting, seen = ["run", "check"], set[str]()
    while waiting:
        command = waiting.pop()
        seen.add(command)
        options = ["--out", "fw"] if command == "export" else ["--no-figures"]
        done = undeadzone(command, "mine.toml", *options, cwd=tmp_path)
        assert done.returncode == 0, command
        (next_line,) = [line for line in done.stdout.splitlines() if line.startswith("next ")]
        named = set(re.findall(r"undeadzone (\w+) mine\.toml", next_line)) - seen
        waiting += sorted(named - set(waiting))
    assert {"run", "check", "export"} <= seen
