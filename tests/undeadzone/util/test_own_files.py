"""What the user wrote stays: commands replace what they wrote themselves, and nothing else."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from commands import undeadzone
from documents import EXAMPLES
from records import dead_zone
from undeadzone.errors import FileError
from undeadzone.util.own_files import mark_toml, require_own_file, write_own_file
from undeadzone_export.targets import MANIFEST, manifest_text, write_folder

MINE = "# mine\n"


def test_a_text_is_own_until_someone_edits_it(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    for text in ("a = 1\n", "b = 2\n"):
        write_own_file(text, path)
        assert path.read_text().endswith(text)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))  # by an editor of Windows
    write_own_file("c = 3\n", path)
    whole = path.read_text()
    for edited in (whole + "\n", whole.replace("3", "4"), "c = 3\n", "", "\0", f" {whole}"):
        path.write_text(edited)
        with pytest.raises(FileError, match="force=True"):
            write_own_file("d = 4\n", path)
        assert path.read_text() == edited
    write_own_file("d = 4\n", path, force=True)
    require_own_file(path)
    assert path.read_text() == mark_toml("d = 4\n")


def test_a_link_is_someone_elses(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileError, match="exists already"):
        require_own_file(tmp_path / "link")


def test_what_is_no_plain_file_is_never_replaced(tmp_path: Path) -> None:
    """A device of the computer least of all, whoever runs the command."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        refused = undeadzone("init", name, "--force", cwd=tmp_path)
        assert refused.returncode == 2
        assert "cannot write: it is a device, a pipe or a socket" in refused.stderr
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "link").is_symlink()


def identified(folder: Path) -> list[str]:
    """A command that writes NAME.toml, and so on."""
    t = 0.01 * np.arange(1500)
    u = 3 * np.sin(2 * t) + np.sin(9 * t)
    z = np.zeros(t.size)
    for k in range(1, t.size):
        z[k] = z[k - 1] + 0.01 * (2 * u[k - 1] - z[k - 1]) * 3
    y = dead_zone(z, 0.5, 0.5)
    y += (y != 0) * 0.01 * np.random.default_rng(0).normal(size=t.size)
    rows = [f"{a:.2f},{b:.6f},{c:.6f}" for a, b, c in zip(t, u, y, strict=True)]
    (folder / "motor.csv").write_text("t,u,y\n" + "\n".join(rows) + "\n")
    return ["identify", str(folder / "motor.csv"), "--order", "1", "--delay", "0", "--no-figures"]


def designed(folder: Path) -> list[str]:
    shutil.copy(EXAMPLES / "asymmetric_noise.toml", folder / "mine.toml")
    return ["design", str(folder / "mine.toml"), "--maximise", "rate", "--no-figures"]


def tuned(folder: Path) -> list[str]:
    text = (EXAMPLES / "tune.toml").read_text()
    (folder / "mine.toml").write_text(text)
    return ["tune", str(folder / "mine.toml"), "--no-figures", "--budget", "4"]


def arena_tuned(folder: Path) -> list[str]:
    text = (EXAMPLES / "asymmetric_noise.toml").read_text()
    (folder / "mine.toml").write_text(text.replace("duration = 30.0", "duration = 2.0"))
    few = ["--methods", "adaptive_inverse", "--budget", "4", "--processes", "1"]
    return ["arena", str(folder / "mine.toml"), "--tune", *few]


def arm(folder: Path) -> list[str]:
    return ["arm", str(EXAMPLES / "ur5.urdf")]


def started(folder: Path) -> list[str]:
    return ["init", "scenario.toml"]


WRITERS = [
    (identified, "motor.toml", True),
    (designed, "design.toml", True),
    (tuned, "tuned.toml", True),
    (arena_tuned, "tuned.toml", True),
    (arm, "ur5.toml", False),
    (started, "scenario.toml", False),
]


@pytest.mark.parametrize(("make", "name", "owns"), WRITERS)
def test_a_command_keeps_what_the_user_wrote(
    tmp_path: Path, make: Callable[[Path], list[str]], name: str, owns: bool
) -> None:
    command = [*make(tmp_path), "--out", str(tmp_path / "out")]
    path = tmp_path / "out" / name
    path.parent.mkdir()
    path.write_text(MINE)
    refused = undeadzone(*command)
    assert refused.returncode == 2
    assert f"{name}: exists already" in refused.stderr
    assert "--force" in refused.stderr
    assert "--out" in refused.stderr
    assert [file.name for file in path.parent.iterdir()] == [name]  # nothing was computed
    assert path.read_text() == MINE
    assert undeadzone(*command, "--force").returncode in (0, 1)
    text = path.read_text()
    assert text != MINE
    if owns:
        path.write_text(text + MINE)
    assert undeadzone(*command).returncode == 2
    assert path.read_text() == (text + MINE if owns else text)


def test_identify_replaces_its_own_scenario(tmp_path: Path) -> None:
    command = [*identified(tmp_path), "--out", str(tmp_path)]
    assert undeadzone(*command).returncode == 0
    first = (tmp_path / "motor.toml").read_text()
    assert undeadzone(*command).returncode == 0
    assert (tmp_path / "motor.toml").read_text() == first
    assert undeadzone("run", tmp_path / "motor.toml", "--no-figures").returncode in (0, 1)


def test_an_edited_page_stays(tmp_path: Path) -> None:
    """And the page itself works: no other byte of it depends on the digest."""
    out = tmp_path / "live.html"
    command = ["export", str(EXAMPLES / "live.toml"), "--to", "page", "--out", str(out)]
    assert undeadzone(*command).returncode == 0
    whole = out.read_text()
    assert undeadzone(*command).returncode == 0
    assert out.read_text() == whole
    out.write_text(whole.replace("</style>", "p { color: red }</style>"))
    refused = undeadzone(*command)
    assert refused.returncode == 2
    assert "live.html: exists already" in refused.stderr
    assert "--force" in refused.stderr
    assert undeadzone(*command, "--force").returncode == 0
    assert out.read_text() == whole


def test_a_scenario_in_the_place_of_a_log_stays(tmp_path: Path) -> None:
    """By whatever path it is named, and with columns named too."""
    path = tmp_path / "motor.toml"
    path.write_text(MINE)
    for more in ([], ["--columns", "t=1,y=2,u=3"], ["--force"], ["--out", str(tmp_path / "out")]):
        refused = undeadzone("identify", "motor.toml", *more, cwd=tmp_path)
        assert refused.returncode == 2
        assert "motor.toml: this is a scenario, no log" in refused.stderr
        assert path.read_text() == MINE
    log = tmp_path / "motor"
    log.write_text("t,u,y\n")
    assert "exists already" in undeadzone("identify", "motor", cwd=tmp_path).stderr


# --- Folders of exports

REPORT = {"title": "a joint"}


def export(out: Path, *names: str, force: bool = False, text: str = "1") -> None:
    files = dict.fromkeys(names, text)
    write_folder(files | {MANIFEST: manifest_text(REPORT)}, out, force)


def read_files(out: Path) -> dict[str, str]:
    files = (path for path in out.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(out).as_posix(): path.read_text() for path in files}


def test_files_beside_an_export_stay(tmp_path: Path) -> None:
    out = tmp_path / "fw"
    export(out, "joint.c", "examples/a.ino")
    (out / "my_main.c").write_text(MINE)
    (out / "examples" / "mine.ino").write_text(MINE)
    (out / "link").symlink_to(out / "my_main.c")
    export(out, "other.c", text="2")
    assert read_files(out) == {
        "other.c": "2", "my_main.c": MINE, "examples/mine.ino": MINE, "link": MINE
    }  # fmt: skip
    assert (out / "link").is_symlink()
    assert [path.name for path in tmp_path.iterdir()] == ["fw"]


def test_an_edited_export_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "fw"
    for edit in ("joint.c", MANIFEST):
        export(out, "joint.c", "joint.h", force=True)
        (out / edit).write_text((out / edit).read_text() + " ")
        before = (out / edit).read_text()
        with pytest.raises(FileError, match="force=True"):
            export(out, "joint.c", "joint.h")
        assert (out / edit).read_text() == before
        export(out, "joint.c", "joint.h", force=True, text="2")
        assert read_files(out) == {"joint.c": "2", "joint.h": "2"}
    (out / "joint.h").unlink()
    export(out, "joint.c", "joint.h")  # what is gone is no loss


def test_a_link_in_an_export_leads_nowhere_else(tmp_path: Path) -> None:
    out, home = tmp_path / "fw", tmp_path / "home"
    home.mkdir()
    export(out, "joint.c")
    (out / "examples").symlink_to(home)
    with pytest.raises(FileError, match="a link leads elsewhere"):
        export(out, "joint.c", "examples/a.ino", force=True)
    assert not list(home.iterdir())
    assert read_files(out) == {"joint.c": "1"}


def test_a_file_in_the_place_of_a_new_one_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "fw"
    export(out, "joint.c")
    (out / "main.c").write_text(MINE)
    with pytest.raises(FileError, match=r"main\.c: exists already.*force=True"):
        export(out, "joint.c", "main.c", text="2")
    assert read_files(out) == {"joint.c": "1", "main.c": MINE}
    export(out, "joint.c", "main.c", text="2", force=True)
    assert read_files(out) == {"joint.c": "2", "main.c": "2"}


def test_force_puts_files_into_any_folder_and_deletes_none(tmp_path: Path) -> None:
    out = tmp_path / "fw"
    out.mkdir()
    (out / "notes.txt").write_text(MINE)
    (out / "elsewhere").mkdir()
    (out / "joint.c").symlink_to(tmp_path / "target")
    with pytest.raises(FileError, match="is not replaced"):
        export(out, "joint.c")
    export(out, "joint.c", force=True)
    assert read_files(out) == {"notes.txt": MINE, "joint.c": "1"}
    assert (out / "elsewhere").is_dir()
    assert not (tmp_path / "target").exists()


def test_a_manifest_that_is_none_is_no_export(tmp_path: Path) -> None:
    out = tmp_path / "fw"
    export(out, "a")
    text = (out / MANIFEST).read_text()
    for wrong in ("[]", "{", text.replace('"files": {', '"files": [{'), '{"files": ["a"]}'):
        (out / MANIFEST).write_text(wrong)
        with pytest.raises(FileError, match="is not replaced"):
            export(out, "a")


def test_the_command_export_keeps_an_edited_file(tmp_path: Path) -> None:
    command = ["export", EXAMPLES / "firmware.toml", "--out", tmp_path / "fw"]
    assert undeadzone(*command).returncode in (0, 1)
    (tmp_path / "fw" / "my_main.c").write_text(MINE)
    assert undeadzone(*command).returncode in (0, 1)
    source = next((tmp_path / "fw").glob("*_test.c"))
    source.write_text(MINE)
    refused = undeadzone(*command)
    assert refused.returncode == 2
    assert "someone edited it" in refused.stderr
    assert source.read_text() == MINE
    assert undeadzone(*command, "--force").returncode in (0, 1)
    assert source.read_text() != MINE
    assert (tmp_path / "fw" / "my_main.c").read_text() == MINE


def test_a_name_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot write: File name too long"):
        require_own_file(tmp_path / ("x" * 5000))
