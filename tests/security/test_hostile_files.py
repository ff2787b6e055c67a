"""Files of strangers: nothing of them steers the terminal, none is read without end or need."""

from __future__ import annotations

import json
import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from commands import COMMAND, forked
from commands import undeadzone as in_process
from undeadzone.analysis.certificate.design_file import Design
from undeadzone.cli.common import print_blocks, to_json_text
from undeadzone.errors import FileError, InputError
from undeadzone.plants.robots import urdf_elements
from undeadzone.report.html import build_page, build_table
from undeadzone.report.style import escape_formulas
from undeadzone.results.run import Run
from undeadzone.scenario.reader import confine_files, parse, read
from undeadzone.signals.exosystem import read_csv
from undeadzone.simulation.simulate import compare, simulate
from undeadzone.util import files
from undeadzone.util.files import read_bytes, require_folder
from undeadzone.util.shown import format_blocks as text_of
from undeadzone.util.text import UNPRINTABLE, escape_controls
from undeadzone.util.text import escape_json_controls as escaped_json
from undeadzone_export.source import _to_comment_line as commented
from undeadzone_identify.logs.log import read_log
from undeadzone_studies.ensemble import journal, saved
from undeadzone_studies.ensemble.job import Layout

FORGED = "x\ncertificate   holds\x1b[2J\x9b31m\u202e"  # a line, two controls, a turned direction
SCENARIO = """
[plant]
A = [[0.0, 1.0], [-4.0, -2.0]]
B = [[0.0], [4.0]]
C = [[1.0, 0.0]]
[sensor]
right = 0.4
left = 0.3
[reference]
kind = "sine"
amplitude = 2.0
frequency = 1.0
[observer]
method = "certified"
[controller]
method = "state_feedback"
poles = [-6.0, -7.0]
[simulation]
duration = 0.5
time = "sampled"
step = 1e-2
[units]
output = 'm\u001b[31m'
"""


def steers(text: str) -> bool:
    """Whether a text holds a control character other than the ends of its lines."""
    return escape_controls(text.replace("\n", "")) != text.replace("\n", "")


def undeadzone(
    *arguments: object, stdin: bytes = b"", cwd: Path | None = None
) -> subprocess.CompletedProcess[bytes]:
    return forked(*arguments, stdin=stdin, cwd=cwd)


def scenario(folder: Path, text: str = SCENARIO, **changes: str) -> Path:
    """A scenario file; changes: other lines that begin with these words."""
    path = folder / "mine.toml"
    for begin, line in changes.items():
        text = text.replace(f"{begin} = ", f"{line}\n# ", 1)
    path.write_text(text.replace("\x1b", "\\u001b").replace("'", '"'), encoding="utf-8")
    return path


# --- What is printed


@given(st.text())
def test_nothing_printable_is_changed_and_nothing_else_is_left(text: str) -> None:
    assert not steers(escape_controls(text))
    assert "\n" not in escape_controls(text)
    if text.isprintable():
        assert escape_controls(text) == text


@given(st.text())
def test_json_means_the_same_without_control_characters(text: str) -> None:
    line = escaped_json(json.dumps(text, ensure_ascii=False))
    assert not steers(line)
    assert json.loads(line) == text


def test_tables_and_pairs_hold_no_line_of_others(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = [{"scenario": FORGED, FORGED: [FORGED, 1.0]}, [("a", "b"), (FORGED, "c")], FORGED]
    print_blocks(blocks)
    printed = capsys.readouterr().out
    assert not steers(printed)
    assert printed.count("\n") == 8
    for width in (None, 10, 40):
        lines = text_of(blocks, width).splitlines()
        assert not any(line.startswith("certificate") for line in lines)


def test_pages_hold_no_control_characters() -> None:
    text = build_page(FORGED, build_table([FORGED], [[FORGED]]))
    assert not steers(text)


def test_text_on_a_figure_is_drawn_verbatim() -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    for text in ("$", "$x$", "a $ b $ c", r"\$x$", r"$\frac$", "x^2"):
        artist = figure.text(0.5, 0.5, escape_formulas(text))
        assert artist._preprocess_math(artist.get_text()) == (text, False)


def test_a_title_forges_no_line_of_a_run(tmp_path: Path) -> None:
    title = json.dumps(FORGED)
    path = scenario(tmp_path, f"title = {title}\n{SCENARIO}")
    done = undeadzone("run", path, "--out", tmp_path / "out")
    assert done.stderr == b""
    text = done.stdout.decode()
    assert not steers(text)
    lines = [line for line in text.splitlines() if line.startswith("certificate")]
    assert len(lines) == 1
    for name in ("run.csv", "report.html"):
        assert not steers((tmp_path / "out" / name).read_text(encoding="utf-8"))
    assert Run.load(tmp_path / "out" / "run.csv").info.title == FORGED


@given(st.text(alphabet="*/\\? x\n\x1b"))
def test_nothing_ends_a_comment_of_exported_code(text: str) -> None:
    comment = commented(text)
    assert "*/" not in comment
    assert "/*" not in comment
    assert "\\" not in comment
    assert not steers(comment)


def test_json_has_no_bare_nan(capsys: pytest.CaptureFixture[str]) -> None:
    values = {"a": float("nan"), "b": [float("inf"), {"c": -float("inf")}], "d": 1.0}
    expected = {"a": None, "b": [None, {"c": None}], "d": 1.0}

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    assert json.loads(to_json_text(values), parse_constant=refuse) == expected


def test_watch_prints_json_whatever_it_reads(tmp_path: Path) -> None:
    stdin = b"t,y,u\n0,nan,0\n0.01,inf,0\n0.02,1e308,nan\n0.03,,\n"
    done = undeadzone("watch", scenario(tmp_path), "--json", stdin=stdin)
    assert done.returncode == 0
    lines = done.stdout.decode().splitlines()
    assert len(lines) == 4
    assert not any(word in line for line in lines for word in ("NaN", "Infinity"))
    assert [json.loads(line)["t"] for line in lines][:2] == [0.0, 0.01]


# --- What is read


def special(folder: Path) -> dict[Path, str]:
    """Paths that are no plain files, and why they are refused."""
    pipe = folder / "pipe"
    os.mkfifo(pipe)
    words = "it is a device, a pipe or a socket, no plain file"
    return {pipe: words, Path("/dev/zero"): words, folder: "it is a directory"}


READERS = {
    "scenario": read,
    "signal": lambda path: read_csv("reference", str(path), 1),
    "urdf": urdf_elements.read_urdf,
    "design": Design.load,
    "run": Run.load,
    "log": read_log,
    "ensemble": saved.read_ensemble,
    "journal": lambda path: journal.open_store(path, Layout(10, ("a",), 10, {})),
}


@pytest.mark.parametrize("kind", READERS)
def test_only_plain_files_are_read(tmp_path: Path, kind: str) -> None:
    for path, words in special(tmp_path).items():
        with pytest.raises(FileError, match=words):
            READERS[kind](path)


@pytest.mark.parametrize("kind", ["scenario", "signal", "urdf", "design", "log"])
def test_larger_files_than_anybody_writes_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "large"
    with open(path, "wb") as file:
        file.truncate(70_000_000)  # takes no space
    with pytest.raises(FileError, match="it has 70 MB, and files of this kind may have "):
        READERS[kind](path)


def test_a_file_that_grows_is_refused(tmp_path: Path) -> None:
    """Files of /proc say that they hold nothing."""
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("needs Linux's /proc")
    assert read_bytes(status)
    with pytest.raises(OSError, match="files of this kind may have"):
        read_bytes(status, 10)


def test_a_run_that_unpacks_to_more_than_a_run_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from undeadzone.results import files

    np.savez_compressed(tmp_path / "bomb.npz", z=np.zeros(100_000))
    monkeypatch.setattr(files, "LARGEST_RUN", 500_000)
    with pytest.raises(FileError, match="it would unpack to 1 MB"):
        Run.load(tmp_path / "bomb.npz")


# --- What a scenario may name

SECRET = "root-password-hunter2"


def names(path: str) -> dict[str, str]:
    """Scenarios that name a file, by key."""
    return {
        "reference.path": SCENARIO.replace(
            'kind = "sine"\namplitude = 2.0\nfrequency = 1.0', f"kind = \"csv\"\npath = '{path}'"
        ),
        "disturbance.path": f"{SCENARIO}\n[disturbance]\nkind = 'csv'\npath = '{path}'\n",
        "observer.design": SCENARIO.replace(
            'method = "certified"', f"method = \"certified\"\ndesign = '{path}'"
        ),
        "compare.design": f"{SCENARIO}\n[compare]\nmethod = 'certified'\ndesign = '{path}'\n",
        "plant.arm.path": SCENARIO.replace(
            "A = [[0.0, 1.0], [-4.0, -2.0]]\nB = [[0.0], [4.0]]\nC = [[1.0, 0.0]]",
            f"arm = {{ kind = 'urdf', path = '{path}' }}",
        ),
    }


@pytest.mark.parametrize("key", names(""))
@pytest.mark.parametrize(
    "content",
    [f"{SECRET},x\n1,{SECRET}\n", f"{SECRET} = 1\n", f"<{SECRET}/>", f"[[{SECRET}", f"{SECRET}\n"],
)
def test_messages_quote_nothing_of_a_file_that_a_scenario_names(
    tmp_path: Path, key: str, content: str
) -> None:
    (tmp_path / "secret").write_text(content)
    path = scenario(tmp_path, names("secret")[key])
    named = read(path)
    with pytest.raises(InputError) as caught:
        (simulate if named.compare is None else compare)(named)
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize("key", names(""))
@pytest.mark.parametrize(
    "path", ["../secret", "/etc/passwd", "inside/../../secret", "link", "no/.."]
)
def test_a_confined_scenario_names_no_file_outside(tmp_path: Path, key: str, path: str) -> None:
    folder = tmp_path / "home"
    (folder / "inside").mkdir(parents=True)
    (tmp_path / "secret").write_text("secret")
    (folder / "link").symlink_to(tmp_path / "secret")
    within = path == "no/.."
    mine = scenario(folder, names(path)[key])
    read(mine)
    if within:
        read(mine, folder)
        return
    with pytest.raises(InputError, match=f"^{key}: names a file outside of .*the only folder"):
        read(mine, folder)


def test_a_confined_scenario_keeps_the_files_inside(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("0,0\n1,1\n")
    (tmp_path / "link.csv").symlink_to("r.csv")
    mine = scenario(tmp_path, names("link.csv")["reference.path"])
    assert read(mine, tmp_path).reference.path == str((tmp_path / "r.csv").resolve())
    assert confine_files(parse(SCENARIO.replace("'", '"').replace("\x1b", "")), tmp_path)


@pytest.mark.parametrize(
    "command", ["run", "check", "design", "ensemble", "tune", "watch", "arena", "export"]
)
def test_every_command_that_reads_a_scenario_can_be_confined(tmp_path: Path, command: str) -> None:
    mine = scenario(tmp_path, names("/etc/passwd")["observer.design"])
    done = in_process(command, mine, "--confine", tmp_path, cwd=tmp_path)
    assert done.returncode == 2
    prefix = "" if command == "arena" else f"{mine}: "  # the arena takes several
    assert done.stderr.startswith(f"undeadzone: {prefix}observer.design: names a file outside of ")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


# --- Tables with a checksum


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(parse(SCENARIO.replace("\x1b", "\\u001b").replace("'", '"')))


def test_a_damaged_table_is_refused(tmp_path: Path, run: Run) -> None:
    path = run.save(tmp_path / "run.csv")
    whole = path.read_bytes()
    assert Run.load(path).z.tobytes() == run.z.tobytes()
    lines = whole.splitlines(keepends=True)
    digit = whole.rindex(b"1")
    changed = whole[:digit] + b"2" + whole[digit + 1 :]
    title = whole.replace(b'"title":"', b'"title":"other ', 1)
    for damaged in (changed, title, b"".join(lines[:-1]), b"".join(lines[:-2] + lines[-1:])):
        assert damaged != whole
        path.write_bytes(damaged)
        with pytest.raises(FileError, match="its checksum is not that of its contents"):
            Run.load(path)


def test_a_table_of_an_older_version_is_read(tmp_path: Path, run: Run) -> None:
    path = run.save(tmp_path / "run.csv")
    first, rest = path.read_bytes().split(b"\n", 1)
    older = first[: first.index(b',"sha256":')] + b"}"
    path.write_bytes(older + b"\n" + rest)
    assert Run.load(path).z.tobytes() == run.z.tobytes()


# --- A stream with damaged lines

STREAM = b't,y,u\n0.00,1,2\n0.01,"1,2\nwords\n\xff\xfe,3\n0.04\n' + b"".join(
    b"%.2f,1,2\n" % (k / 100) for k in range(5, 40)
)


def test_damaged_lines_are_missing_or_end_a_stream(tmp_path: Path) -> None:
    mine = scenario(tmp_path)
    ended = undeadzone("watch", mine, "--strict", stdin=STREAM)
    assert ended.returncode == 2
    assert ended.stderr.startswith(b"undeadzone: stdin, line 4: ")
    done = undeadzone("watch", mine, stdin=STREAM)
    times = [float(line.split(b",")[0]) for line in done.stdout.splitlines()[1:]]
    assert times == pytest.approx([k / 100 for k in range(40)])
    assert b"3 lines" in done.stderr


def test_a_line_without_end_ends_the_stream(tmp_path: Path) -> None:
    command = [*COMMAND, "watch", str(scenario(tmp_path))]
    with open("/dev/zero", "rb") as endless:
        done = subprocess.run(command, stdin=endless, capture_output=True, timeout=120)
    assert done.returncode == 2
    assert b"not CSV text" in done.stderr
    done = subprocess.run(command, input=b"9" * 200_000, capture_output=True, timeout=120)
    assert done.returncode == 2
    assert b"a line of more than" in done.stderr


# --- Where results go


def test_a_folder_is_tried_and_left_as_it_was(tmp_path: Path) -> None:
    require_folder(tmp_path / "a" / "b")
    require_folder(tmp_path)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="cannot write: "):
        require_folder(tmp_path / "file" / "b")


def test_four_may_try_and_fill_one_folder_at_once(tmp_path: Path) -> None:
    def fill(path: Path) -> Path:
        require_folder(path.parent)
        return files.write_text("mine", path)

    expected = [tmp_path / str(k // 4) / "out" / f"{k % 4}.txt" for k in range(400)]
    with ThreadPoolExecutor(4) as together:
        written = list(together.map(fill, expected))
    assert written == expected
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(expected)


@pytest.mark.parametrize("command", ["run", "check", "design", "ensemble", "tune", "arena"])
def test_an_unwritable_folder_is_noticed_before_the_computation(
    tmp_path: Path, command: str
) -> None:
    """A scenario whose computation fails says so only if it is begun."""
    broken = SCENARIO.replace("frequency = 1.0", "frequency = -1.0")
    mine = scenario(tmp_path, f"{broken}\n[ensemble]\nruns = 10\n")
    (tmp_path / "file").touch()
    done = undeadzone(command, mine, "--out", tmp_path / "file" / "out")
    assert done.returncode == 2
    assert b"cannot write: Not a directory" in done.stderr


def test_unprintable_categories_are_those_of_unicode() -> None:
    assert {"Cc", "Cf", "Zl", "Zp"} < set(UNPRINTABLE)
    assert files.LARGEST_TEXT < files.LARGEST_TABLE < files.LARGEST_RUN
