"""What is installed from a wheel is whole: commands run outside of the checkout."""

from __future__ import annotations

import email
import hashlib
import json
import os
import re
import subprocess
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from tools.supply import hashes, parts, sbom, sizes

from packed import ROOT, copied, environment, install, run
from packed import wheel as built
from requirements import import_package

ARENA = "undeadzone_arena"  # a distribution of its own
OTHERS = ("IPython", "casadi", "dask", "distributed", "matplotlib", "numpy", "scipy")
LARGEST = 1_650_000  # bytes
BUILT = ("pyproject.toml",)  # the builder adds it
GIT = (ROOT / ".git").exists()  # a source distribution has none


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout, built elsewhere."""
    import_package("hatchling")
    import_package("hatch_fancy_pypi_readme")
    return built(copied(tmp_path_factory.mktemp("wheels")))


@pytest.fixture(scope="module")
def arena(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the methods of the literature."""
    return built(copied(tmp_path_factory.mktemp("wheels")) / "packages" / ARENA)


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel; its dependencies are those of this one."""
    return environment(wheel, tmp_path_factory.mktemp("environment") / "venv")


def text_in(wheel: Path, name: str) -> str:
    """A file of the wheel's metadata."""
    with zipfile.ZipFile(wheel) as archive:
        (path,) = [path for path in archive.namelist() if path.endswith(f".dist-info/{name}")]
        return archive.read(path).decode("utf-8")


def test_the_wheels_hold_every_file_of_the_packages(wheel: Path, arena: Path) -> None:
    members, apart = (set(zipfile.ZipFile(path).namelist()) for path in (wheel, arena))
    for path in (ROOT / "src").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            member = str(path.relative_to(ROOT / "src"))
            assert (member in members) != (member in apart) == (ARENA in member)


def test_the_wheel_is_small(wheel: Path) -> None:
    assert wheel.stat().st_size < LARGEST


def test_the_same_source_gives_the_same_bytes(wheel: Path, tmp_path: Path) -> None:
    """Whatever the folder, its times and modes, who may read new files, language and time zone."""
    before = os.umask(0o077)
    try:
        source = copied(tmp_path / "a folder" / "deeper")
        for path in source.rglob("*"):
            os.utime(path, (1e9, 1.2e9))
            path.chmod(0o700 if path.is_dir() else 0o600)
        again = built(source, LC_ALL="tr_TR.UTF-8", TZ="Asia/Kathmandu", PYTHONHASHSEED="7")
    finally:
        os.umask(before)
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()


# --- What comes with it


def test_hashes_are_of_the_versions_that_are_tested() -> None:
    """Every name of constraints.txt has one, and the file for users is what the wheel brings."""
    everything, runtime = hashes.read(hashes.EVERYTHING), hashes.read(hashes.RUNTIME)
    assert {name: version for name, (version, _) in everything.items()} == parts.pinned()
    assert runtime == {name: everything[name] for name in parts.needed()}
    for _, values in everything.values():
        assert values
        assert all(re.fullmatch("[0-9a-f]{64}", value) for value in values)
    for path in (hashes.EVERYTHING, hashes.RUNTIME):
        assert not re.search(r"://|/|find-links|index", path.read_text(encoding="utf-8"))


def test_the_bill_of_materials_is_complete_and_the_same_again(wheel: Path) -> None:
    path = sbom.write(wheel)
    content = path.read_bytes()
    bill = json.loads(content)
    assert sbom.write(wheel).read_bytes() == content
    assert (bill["bomFormat"], bill["specVersion"], bill["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(r"urn:uuid:[0-9a-f-]{36}", bill["serialNumber"])
    whole = bill["metadata"]["component"]
    assert whole["hashes"][0]["content"] == hashlib.sha256(wheel.read_bytes()).hexdigest()
    versions, required = parts.pinned(), parts.needed()
    assert [part["name"] for part in bill["components"]] == list(required)
    for part in bill["components"]:
        assert part["type"] == "library"
        assert part["purl"] == f"pkg:pypi/{part['name']}@{versions[part['name']]}"
        assert part["hashes"][0]["alg"] == "SHA-256"
        assert part["licenses"]
    refs = {part["bom-ref"] for part in (*bill["components"], whole)}
    assert {entry["ref"] for entry in bill["dependencies"]} == refs
    assert {ref for entry in bill["dependencies"] for ref in entry["dependsOn"]} <= refs
    reached, ends = set(), [whole["bom-ref"]]
    depends = {entry["ref"]: entry["dependsOn"] for entry in bill["dependencies"]}
    while ends:
        reached.add(ends.pop())
        ends += [ref for known in reached for ref in depends[known] if ref not in reached]
    assert reached == refs


def test_every_dependency_has_a_purpose() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    direct = {parts.normal(re.split("[<>=]", text)[0]) for text in project["dependencies"]}
    assert sizes.PURPOSE.keys() == direct
    page = (ROOT / "docs/install.md").read_text(encoding="utf-8")
    for name in direct:
        assert f"| {name} | {sizes.PURPOSE[name]} |" in page


def test_a_run_without_figures_imports_what_the_page_says() -> None:
    """Neither a compiler nor a drawing program is loaded for it."""
    least = sorted(sizes.imported() & parts.needed().keys())
    page = " ".join((ROOT / "docs/install.md").read_text(encoding="utf-8").split())
    assert f"`run --no-figures` imports {', '.join(least)}:" in page


def test_the_version_is_the_same_everywhere(wheel: Path) -> None:
    source = (ROOT / "src/undeadzone/__init__.py").read_text(encoding="utf-8")
    (version,) = re.findall(r'^__version__ = "(.*)"$', source, re.MULTILINE)
    assert email.message_from_string(text_in(wheel, "METADATA"))["Version"] == version
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" not in project
    cited = cited_keys()
    assert (cited["version"], cited["license"]) == (version, project["license"])
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert changes.startswith("# Changelog\n")
    assert "\n## Unreleased\n" in changes
    assert f"\n## {version} ({cited['date-released']})\n" in changes


def cited_keys() -> dict[str, Any]:
    """The contents of CITATION.cff."""
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    return dict(import_package("yaml").safe_load(text))


def test_the_citation_is_valid() -> None:
    """As Citation File Format 1.2.0 demands of the keys that are there; no other key is."""
    cited = cited_keys()
    assert (cited.pop("cff-version"), cited.pop("type")) == ("1.2.0", "software")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", cited.pop("date-released"))
    assert [list(author) for author in cited.pop("authors")] == [["name"]]
    assert all(isinstance(word, str) for word in cited.pop("keywords"))
    assert all(isinstance(value, str) for value in cited.values())
    assert cited.keys() == {"license", "message", "title", "version"}


@pytest.mark.parametrize(
    "folder", [ROOT, ROOT / "packages/deadzone_update", ROOT / "packages" / ARENA]
)
def test_classifiers_name_the_tested_versions(folder: Path) -> None:
    text = (folder / "pyproject.toml").read_text(encoding="utf-8")
    named = ", ".join(re.findall(r'"Programming Language :: Python :: (3\.\d+)"', text))
    versions = (ROOT / "docs/versions.md").read_text(encoding="utf-8")
    assert f"\nTests run with Python {named} on Linux." in versions


def test_a_package_index_shows_no_link_that_leads_nowhere(wheel: Path) -> None:
    """Files of the repository have no address there: links are text, images are left out."""
    description = email.message_from_string(text_in(wheel, "METADATA")).get_payload()
    assert description.startswith("# undeadzone\n")
    assert not re.findall(r"\]\((?!https?:)", description)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for code in re.findall(r"```python\n.*?```", readme, re.S):
        assert code in description
    for heading in re.findall(r"^## .*$", readme, re.M):
        assert heading in description


def test_no_address_is_invented(wheel: Path) -> None:
    """The project has no public place yet. docs/release.md: who publishes adds the addresses."""
    assert "Project-URL" not in email.message_from_string(text_in(wheel, "METADATA"))


def test_a_source_distribution_has_every_folder_and_page_of_the_project() -> None:
    """What the tests, the pages and a reviewer need is in it, and every entry exists."""
    tracked = run("git", "ls-files", cwd=ROOT).splitlines() if GIT else []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    for pattern in included:
        assert list(ROOT.glob(pattern.lstrip("/"))), pattern
    tops = {Path(path).parts[0] for path in tracked}
    for top in sorted(top for top in tops if not top.startswith(".")):
        assert any(Path("/", top).match(pattern) for pattern in included) or top in BUILT, top


def test_every_extra_is_explained() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs/install.md").read_text(encoding="utf-8")
    explained = re.findall(r"^\| `(\w+)` \|", page, re.M)
    assert sorted(explained) == sorted(project["optional-dependencies"])


def test_commands_run_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    command = installed / "undeadzone"
    place = "import undeadzone as uz; print(uz.__file__, [getattr(uz, n) for n in uz.__all__])"
    assert str(installed.parent) in run(installed / "python", "-c", place, cwd=tmp_path)
    run(command, "init", "mine.toml", cwd=tmp_path)
    printed = run(command, "run", "mine.toml", "--json", "--out", "out", cwd=tmp_path)
    assert json.loads(printed)["diverged_at"] is None
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


def test_the_methods_of_the_literature_are_named_until_they_are_installed(
    installed: Path, arena: Path, tmp_path: Path
) -> None:
    """A command and a method of the other wheel: their message names it, and it is enough."""
    command = installed / "undeadzone"
    text = (ROOT / "examples/tune.toml").read_text(encoding="utf-8")
    ranges = "right = [0.3, 2.0]\nleft = [0.3, 2.0]"
    tables = re.sub(r"L = .*?width_max = 3.0", ranges, text.split("[ensemble]")[0], flags=re.S)
    (tmp_path / "mine.toml").write_text(tables.replace("certified", "ekf"))
    contest = ["arena", "mine.toml", "--methods", "ekf", "--seeds", "1", "--processes", "1"]
    for words in (contest, ["check", "mine.toml"]):
        done = subprocess.run(
            [command, *words], cwd=tmp_path, capture_output=True, env={}, text=True
        )
        assert done.returncode == 2
        assert f"pip install {ARENA}" in done.stderr
    install(arena, installed)
    assert "full_state" in run(command, *contest, cwd=tmp_path)


def test_every_example_comes_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    command = installed / "undeadzone"
    names = json.loads(run(command, "init", "--list", "--json", cwd=tmp_path))["examples"]
    each = "from undeadzone.cli import group; import sys; [group.main(['init', '--example', name]"
    each += ", standalone_mode=False) for name in sys.argv[1:]]"
    run(installed / "python", "-c", each, *names, cwd=tmp_path)
    written = {path.name: path.read_bytes() for path in tmp_path.glob("*.*")}
    originals = {path.name: path.read_bytes() for path in (ROOT / "examples").glob("*.*")}
    assert written == originals
    run(command, "run", "paper_5sin.toml", "--no-figures", cwd=tmp_path)


def test_types_reach_a_program_that_uses_the_package(installed: Path, tmp_path: Path) -> None:
    """mypy sees the types of the installed package, and so the mistake."""
    right = "import undeadzone as uz\n\nrun = uz.simulate(uz.read('mine.toml'))\n"
    right += "error: float = run.rms_estimation\n"
    (tmp_path / "right.py").write_text(right)
    (tmp_path / "wrong.py").write_text(right.replace("float", "str"))
    # To read what others' code says of itself takes most of the time, and is not asked.
    others = ",".join(f"{name}.*" for name in OTHERS)
    skipped = f"[mypy-{others}]\nfollow_imports = skip\nfollow_imports_for_stubs = true\n"
    (tmp_path / "mypy.ini").write_text(f"[mypy]\n{skipped}", encoding="utf-8")
    cache = ROOT / ".pytest_cache" / "mypy"
    mypy = [installed / "python", "-m", "mypy", "--strict", "--cache-dir", cache]
    with pytest.raises(AssertionError) as found:
        run(*mypy, "right.py", "wrong.py", cwd=tmp_path)
    assert 'wrong.py:4: error: Incompatible types in assignment (expression has type "float", ' in (
        str(found.value)
    )
    assert "Found 1 error in 1 file (checked 2 source files)" in str(found.value)
