"""MATLAB 7.3 files: HDF5 behind 512 bytes of text, with reversed dimensions and named classes."""

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from commands import forked
from undeadzone.errors import FileError, InputError
from undeadzone.logs import matlab73, whole
from undeadzone.nonlinearities.play import levels
from undeadzone_identify.logs.log import read_log

T = 0.01 * np.arange(50)
U = np.sin(T)
Y = np.cos(T)
OF_TYPE = {"f8": "double", "f4": "single", "u1": "logical", "u2": "uint16"}


def put(group: Any, name: str, values: Any, kind: str = "", **options: Any) -> None:
    """A matrix as MATLAB stores it: its columns are rows, and it is named by its class."""
    matrix = np.atleast_2d(np.asarray(values))
    if np.ndim(values) == 1:
        matrix = matrix.T
    entry = group.create_dataset(name, data=matrix.T, **options)
    own = OF_TYPE.get(matrix.dtype.str[1:], str(matrix.dtype))
    entry.attrs["MATLAB_class"] = np.bytes_(kind or own)


def matlab_file(path: Path) -> Any:
    """An empty one with what cells refer to, and a text, a cell and an array of structs."""
    file = h5py.File(path, "w", userblock_size=512)
    referred = file.create_group("#refs#")
    put(referred, "a", np.zeros(50))
    put(file, "words", np.frombuffer("name".encode("utf-16-le"), "u2"), "char")
    cell = file.create_dataset("cell", data=np.array([[referred["a"].ref]], h5py.ref_dtype))
    cell.attrs["MATLAB_class"] = np.bytes_("cell")
    many = file.create_group("many")
    many.attrs["MATLAB_class"] = np.bytes_("struct")
    many.create_dataset("x", data=np.array([[referred["a"].ref] * 2], h5py.ref_dtype))
    none = file.create_dataset("none", data=np.array([0, 0], "u8"))
    none.attrs["MATLAB_class"] = np.bytes_("double")
    none.attrs["MATLAB_empty"] = np.uint8(1)
    pair = np.zeros((1, 50), [("real", "f8"), ("imag", "f8")])
    file.create_dataset("pair", data=pair).attrs["MATLAB_class"] = np.bytes_("double")
    return file


def close(file: Any, path: Path) -> Path:
    file.close()
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Thu Nov 26 2026 HDF5 schema 1.00 ."
    with path.open("r+b") as opened:
        opened.write(head.ljust(124) + b"\x00\x02IM")
    return path


def test_vectors_of_every_type(tmp_path: Path) -> None:
    """Columns, rows, packed ones; texts, cells, complex and empty matrices are left out."""
    path = tmp_path / "log.mat"
    with matlab_file(path) as file:
        put(file, "t", T, compression=3, chunks=(1, 20))
        put(file, "u", np.round(100 * U).astype("i2"))
        put(file, "y", Y[None].astype("f4"), shuffle=True, compression=3)
        put(file, "is_on", U > 0)
        close(file, path)
    log = read_log(path)
    assert np.array_equal(log.t, T)
    assert np.array_equal(log.u[:, 0], np.round(100 * U))
    assert np.array_equal(log.y[:, 0], Y.astype("f4"))
    names = {title.name for title, _ in whole.of_mat(path)}
    assert names == {"t", "u", "y"}


def test_a_square_matrix_is_not_transposed(tmp_path: Path) -> None:
    path = tmp_path / "square.mat"
    rows = np.arange(9.0).reshape(3, 3)
    with matlab_file(path) as file:
        put(file, "data", rows)
        close(file, path)
    found = {title.name: list(values) for title, values in whole.of_mat(path)}
    assert found == {"data[0]": [0, 3, 6], "data[1]": [1, 4, 7], "data[2]": [2, 5, 8]}


def test_the_fields_of_a_struct_are_columns(tmp_path: Path) -> None:
    """Also those of one in another, and with the struct's name if a field's is taken."""
    path = tmp_path / "struct.mat"
    with matlab_file(path) as file:
        log = file.create_group("log")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        inner = log.create_group("signals")
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        put(log, "time", T)
        put(log, "u", U)
        put(inner, "y", Y)
        put(log, "gain", U)
        put(inner, "gain", Y)
        inner["again"] = log  # a group within itself
        close(file, path)
    assert np.array_equal(read_log(path).y[:, 0], Y)
    names = {title.name for title, _ in whole.of_mat(path)}
    assert names == {"time", "u", "y", "log.gain", "log.signals.gain"}


def test_without_h5py_the_message_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.mat"
    with matlab_file(path) as file:
        put(file, "t", T)
        close(file, path)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InputError, match=r"pip install 'undeadzone\[matlab\]'"):
        read_log(path)
    assert forked("identify", str(path)).returncode == 2


def test_what_leads_out_of_the_file_is_refused(tmp_path: Path) -> None:
    """Links, data in another file, and a filter that the library would load."""
    other = tmp_path / "other.mat"
    with matlab_file(other) as file:
        put(file, "y", Y)
    raw = tmp_path / "secret.bin"
    raw.write_bytes(Y.tobytes())
    path = tmp_path / "log.mat"

    def refused(words: str, spoil: Any) -> None:
        path.unlink(missing_ok=True)
        with matlab_file(path) as file:
            put(file, "t", T)
            spoil(file)
            close(file, path)
        with pytest.raises(FileError, match=words):
            whole.of_mat(path)

    def link(file: Any) -> None:
        file["y"] = h5py.ExternalLink(str(other), "/y")

    def outside(file: Any) -> None:
        where = [(str(raw), 0, raw.stat().st_size)]
        entry = file.create_dataset("y", (1, 50), "f8", external=where)
        entry.attrs["MATLAB_class"] = np.bytes_("double")

    def virtual(file: Any) -> None:
        layout = h5py.VirtualLayout((1, 50), "f8")
        layout[:] = h5py.VirtualSource(str(other), "y", shape=(1, 50))
        file.create_virtual_dataset("y", layout).attrs["MATLAB_class"] = np.bytes_("double")

    refused("link", link)
    refused("another file", outside)
    refused("another file", virtual)
    refused("filters", lambda file: put(file, "y", Y, compression="lzf"))


def test_sizes_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The declared ones, and the bytes that a part unpacks to whatever it declares."""
    path = tmp_path / "log.mat"
    with matlab_file(path) as file:
        put(file, "y", np.zeros(100_000), compression=9)
        close(file, path)
    content = path.read_bytes()
    assert len(content) < 20_000
    assert matlab73.load_matlab_73(content, 1_000_000)["y"].shape == (100_000, 1)
    with pytest.raises(ValueError, match="larger than any log"):
        matlab73.load_matlab_73(content, 99_999)
    with pytest.raises(ValueError, match="unpack to more"):
        matlab73.load_matlab_73(content, 700_000)


def test_torn_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    with matlab_file(path) as file:
        put(file, "t", T)
        close(file, path)
    content = path.read_bytes()
    for length in (520, 700, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(FileError):
            whole.of_mat(path)


def test_identify_answers_as_along_the_same_log_in_a_csv(tmp_path: Path) -> None:
    """From a MATLAB 7.3 file to identify.json: two positions with a gap of 0.3 between them."""
    t = 0.02 * np.arange(600)
    goal = 2 * np.sin(1.3 * t) + np.sin(3.1 * t)
    level = levels(goal[:, None], np.array([0.15]), np.array([0.15]), np.zeros(1))[:, 0]
    position = level + 0.003 * np.random.default_rng(73).normal(size=t.size)
    packed, plain = tmp_path / "log.mat", tmp_path / "log.csv"
    with matlab_file(packed) as file:
        for name, values in (("t", t), ("goal", goal), ("position", position)):
            put(file, name, values)
        close(file, packed)
    rows = np.column_stack([t, goal, position])
    np.savetxt(plain, rows, "%.17g", ",", header="t,goal,position", comments="")
    answers = []
    for path in (packed, plain):
        done = forked("identify", path.name, "--out", f"{path.name}-out", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        answer = json.loads((tmp_path / f"{path.name}-out" / "identify.json").read_text())
        answers.append((answer["verdict"], answer["width"]))
    assert answers[0] == answers[1]
    verdict, (_, low, high) = answers[0]
    assert verdict == "play"
    assert low < 0.3 < high
