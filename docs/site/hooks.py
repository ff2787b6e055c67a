"""Hooks of the documentation site: pages made of code, and links that leave docs/.

`mkdocs build` calls the functions on_...; docs/site/tutorials.py runs the tutorials.
"""

from __future__ import annotations

import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
METHODS = ROOT / "docs/methods"
sys.path.insert(0, str(HERE))

import tutorials  # noqa: E402

PROJECT = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "KNOWN_GAPS.md",
    "benchmarks/RESULTS.md",
    "tools/fuzz/RESULTS.md",
    "tools/mutants/RESULTS.md",
)
HOW_TO = (
    "record_a_log",
    "columns_and_units",
    "read_the_answer",
    "unknown_numbers",
    "undecided",
    "narrow_an_interval",
    "compensate",
    "live_samples",
    "many_runs",
)
TRADES = (
    "scale_and_sensor",
    "valve_and_loop",
    "joint_and_servo",
    "axis_and_mount",
    "class_room",
    "paper",
    "filter_author",
)
CHAPTERS = {
    "Start": ["index.md", "try.md", "install.md", "cases.md", "gallery.md", "pages.md"],
    "Readers": [f"trades/{name}.md" for name in TRADES],
    "Tutorials": ["tour.md", "exercises.md"],
    "How-to": [
        *(f"howto/{name}.md" for name in HOW_TO),
        "what_goes_wrong.md",
        "which.md",
        "compare.md",
        "export_plc.md",
        "export_fmu.md",
        "faq.md",
    ],
    "Guides": [
        "watch.md",
        "signal.md",
        "export.md",
        "deadzone_update.md",
        "ensemble.md",
        "fit.md",
        "tune.md",
        "security.md",
    ],
    "Explanation": [
        "model.md",
        "nonlinearities.md",
        "play.md",
        "actuator.md",
        "identify.md",
        "identify_models.md",
        "identify_decisions.md",
        "identify_loops.md",
        "identifiability.md",
        "filters.md",
        "filter_equations.md",
        "filter_extensions.md",
        "innovation_tests.md",
        "filter_accuracy.md",
        "observer.md",
        "adaptation.md",
        "certificate.md",
        "certificate_regions.md",
        "proof.md",
        "rates.md",
        "simulation.md",
        "export_accuracy.md",
        "robots.md",
        "robot_gears.md",
        "robot_paths.md",
        "arena.md",
        "paper.md",
        "paper_repaired.md",
        "paper_numbers.md",
    ],
    "Reference": [
        "command_line.md",
        "keys.md",
        "scenario.md",
        "scenario_plant.md",
        "scenario_observer.md",
        "scenario_observer_2.md",
        "scenario_observer_3.md",
        "scenario_controller.md",
        "scenario_controller_2.md",
        "scenario_studies.md",
        "json.md",
        "json_logs.md",
        "versions.md",
        "notation.md",
        "references.md",
    ],
}
CONTRIBUTING = [
    "architecture.md",
    "testing.md",
    "decisions.md",
    "decisions_methods.md",
    "decisions_code.md",
    "release.md",
]
MOVED = {  # old address: new page
    "house.md": "architecture.md",
    "glossary.md": "notation.md",
    "hear.md": "deadzone_update.md",
}
DESCRIBE = "Describe plant, sensor and scenario"
RUN = "Simulate and plot"
ESTIMATE = "Estimate along a log or on live samples"
OBSERVE = "Choose an observer"
PROVE = "Design gains with a proof"
VARY = "Vary, tune and replay runs"
TASKS = {  # the beginning of a name's path: its task, in the order of the API page
    "undeadzone_identify": "Identify a log",
    "undeadzone.plants": DESCRIBE,
    "undeadzone.nonlinearities": DESCRIBE,
    "undeadzone.scenario": DESCRIBE,
    "undeadzone.simulation": RUN,
    "undeadzone.report": RUN,
    "undeadzone.results": RUN,
    "undeadzone.simulation.estimate": ESTIMATE,
    "undeadzone.simulation.online": ESTIMATE,
    "undeadzone.results.estimation": ESTIMATE,
    "undeadzone.numerics": "Update your own Kalman filter",
    "undeadzone.observers": OBSERVE,
    "undeadzone.interfaces": OBSERVE,
    "undeadzone.registry": OBSERVE,
    "undeadzone.controllers": "Choose a controller or a compensator",
    "undeadzone.compensators": "Choose a controller or a compensator",
    "undeadzone.signals": "Choose a reference or a path",
    "undeadzone_export": "Export an observer",
    "undeadzone_studies": VARY,
    "undeadzone.scenario.ensemble_table": VARY,
    "undeadzone.scenario.tune_table": VARY,
    "undeadzone_design": PROVE,
    "undeadzone.analysis": PROVE,
    "undeadzone.linalg": PROVE,
    "undeadzone.errors": "Catch an error",
}
# Old anchors of a page that was split: the page and anchor that replaced each.
MOVED_ANCHORS = {
    "filters.md": {
        "prior-and-reading": "filters.md#assumptions-the-prior",
        "which-readings-are-certain": "filter_equations.md#certain-measurements",
        "what-else-may-be-wrong-censored": "filter_equations.md#disturbance-bias-and-model-error",
        "how-strong-the-disturbance-is": "filter_equations.md#multiple-models-of-the-disturbance",
        "what-silence-says": "filter_equations.md#censored-samples",
        "readings-that-end": "filter_extensions.md#limits-of-the-sensors-range",
        "readings-that-are-wrong": "filter_extensions.md#outliers",
        "a-world-that-is-not-as-claimed": "innovation_tests.md",
        "looking-back": "filter_extensions.md#smoothing",
        "what-cannot-be-known": "filter_extensions.md#bias-or-centre-calibrated",
        "to-the-controller": "filter_extensions.md#feedback-of-the-estimated-model-error",
        "how-good-is-that": "filter_accuracy.md",
        "measured": "filter_accuracy.md#coverage-of-95-intervals",
    },
}
# Sections that stand on another page under their old anchors.
MOVED_SECTIONS = {
    ("scenario.md", "scenario_plant.md"): "plant reference",
    ("scenario.md", "scenario_observer.md"): "observer",
    ("scenario.md", "scenario_controller.md"): "controller",
    ("scenario.md", "scenario_controller_2.md"): "compensator",
    ("scenario.md", "scenario_studies.md"): "ensemble tune",
    ("paper.md", "paper_repaired.md"): """
        adaptation-bounded bounded cancelled decomposition displacements figure-1 global
        indicators lyapunov manipulator observer-poles practical-use reading-tracked
        robust-noise state-1 state-2 switching symmetric theorem theorem-bounded
        theorem-known tracking unknown-width width-bound widths
    """,
    ("paper.md", "paper_numbers.md"): "by-number theorem-41-with-its-own-law letters",
    ("certificate.md", "certificate_regions.md"): """
        disturbance-and-noise-l2-gain extensions falsification-attempts-to-break-it
        nonlinear-plants-on-a-region plants-with-and-without-a-certificate
        proof-by-interval-arithmetic region-and-gains ultimate-bound-and-leakage
        uncertain-plant-in-closed-loop
    """,
    ("robots.md", "robot_gears.md"): """
        control-and-estimation-across-the-gap elastic-joint export-to-mujoco gears
        identifiability-of-the-gap where-is-the-encoder
    """,
    ("robots.md", "robot_paths.md"): """
        from-the-tip-to-the-joints paths refused-paths
    """,
    ("filter_equations.md", "filter_extensions.md"): """
        bias-or-centre-calibrated feedback-of-the-estimated-model-error
        limits-of-the-sensors-range outliers sensor-shape smoothing
    """,
    ("decisions.md", "decisions_methods.md"): """
        arms-behind-gears certificates-and-search filters gears identification
    """,
    ("decisions.md", "decisions_code.md"): """
        compiler-and-kernels dependencies export
    """,
    ("json.md", "json_logs.md"): """
        estimate identify watch
    """,
}
for (page, place), names in MOVED_SECTIONS.items():
    MOVED_ANCHORS.setdefault(page, {}).update({name: f"{place}#{name}" for name in names.split()})
TRY = """# Try it

The whole loop of plant, sensor, observer and controller, computed in your browser at each move of a
slider; nothing is sent anywhere. [The page alone](live.html) opens from disk too, and [undeadzone
export](export.md#the-live-page) makes one of your own scenario.

<iframe class="live" src="live.html" title="The live page"></iframe>
"""
WORKER = re.compile(r'<script src="https://[^"]*/iframe-worker/shim"></script>')
CELL = re.compile(r"<t[dh][^>]*>.*?</t[dh]>", re.S)
CODE = re.compile(r"<code[^>]*>.*?</code>", re.S)
LINK = re.compile(r"(\]\()([^)#\s:]+)(#[^)]*)?(\))")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Order the pages."""
    table = (METHODS / "index.md").read_text(encoding="utf-8")
    methods = dict.fromkeys(re.findall(r"\]\((\w+\.md)", table))  # in its order
    chapters = {title: list[Any](pages) for title, pages in CHAPTERS.items()}
    chapters["Tutorials"] += [f"tutorials/{name}.md" for name in tutorials.NAMES]
    chapters["Reference"].insert(0, "api.md")
    chapters["Methods"] = ["methods/index.md", *(f"methods/{name}" for name in methods)]
    chapters["Contributing"] = CONTRIBUTING + [project_page(path) for path in PROJECT]
    nav = [{title: pages} for title, pages in chapters.items()]
    config.nav = nav
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made of code, and the project's own."""
    for path in PROJECT:
        add(files, config, project_page(path), (ROOT / path).read_text(encoding="utf-8"))
    add(files, config, "api.md", reference())
    add(files, config, "try.md", TRY)
    for old, new in (MOVED | moved_methods()).items():
        add(files, config, old, redirect_page(new))
    for name, content in tutorials.pages(ROOT / "docs/tutorials").items():
        add(files, config, f"tutorials/{name}", content)
    for path in sorted((HERE / "assets").rglob("*")):
        if path.is_file():
            where = f"assets/{path.relative_to(HERE / 'assets').as_posix()}"
            add(files, config, where, path.read_bytes())
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let links to files outside of docs/ lead to their pages or copies, and old anchors on."""
    markdown += moved_sections(MOVED_ANCHORS.get(page.file.src_uri, {}))
    source = source_of(page.file.src_uri)

    def led(match: re.Match[str]) -> str:
        before, target, anchor, after = match.groups()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        where = page_of(path, files, config)
        if where is None:
            return match[0]
        relative = posixpath.relpath(where, posixpath.dirname(page.file.src_uri) or ".")
        return f"{before}{relative}{anchor or ''}{after}"

    return LINK.sub(led, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Let keys in tables break behind each _ and ., and nowhere else."""
    return CELL.sub(lambda cell: CODE.sub(breakable, cell[0]), html)


def breakable(code: re.Match[str]) -> str:
    """A key with places where a line may break; what tags say stays as it is."""
    parts = re.split(r"(<[^>]*>|&[^;]*;)", code[0])
    parts[::2] = [re.sub(r"([_.])(?=\w)", r"\1<wbr>", text) for text in parts[::2]]
    return "".join(parts)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Take the worker of the search from this site, or leave it out where it is not at hand."""
    if not (HERE / "assets/iframe-worker.js").is_file():
        return WORKER.sub("", output)
    folder = posixpath.dirname(page.file.dest_uri) or "."
    where = posixpath.relpath("assets/iframe-worker.js", folder)
    return WORKER.sub(f'<script src="{where}"></script>', output)


def project_page(path: str) -> str:
    """Where a page of the project stands on the site."""
    return f"project/{path.replace('/', '-')}"


def source_of(uri: str) -> str:
    """The path in the repository of a page of the site."""
    for path in PROJECT:
        if uri == project_page(path):
            return path
    return f"docs/{uri}"


def page_of(path: str, files: Files, config: MkDocsConfig) -> str | None:
    """Where a path of the repository stands on the site; None for what stands there already."""
    if path in PROJECT:
        return project_page(path)
    if path == "docs/methods":
        return "methods/index.md"
    if path.startswith("docs/"):
        return re.sub(r"^docs/(tutorials/\w+)\.py$", r"docs/\1.md", path).removeprefix("docs/")
    file = ROOT / path
    if not file.is_file():
        return None
    uri = f"files/{path}.txt" if path.endswith(".md") else f"files/{path}"
    if files.get_file_from_path(uri) is None:
        add(files, config, uri, file.read_bytes())
    return uri


def add(files: Files, config: MkDocsConfig, uri: str, content: str | bytes) -> None:
    """Add a file to the site, in place of one of the same address."""
    present = files.get_file_from_path(uri)
    if present is not None:
        files.remove(present)
    files.append(File.generated(config, uri, content=content))


def moved_sections(anchors: dict[str, str]) -> str:
    """Return a section with each old anchor, whose line leads to what replaced it."""
    if not anchors:
        return ""
    lines = []
    for old, new in anchors.items():
        title = old.replace("-", " ").capitalize()
        lines.append(f'* <span id="{old}"></span>{title}: [{new.replace(".md", "")}]({new})')
    return "\n\n## Sections that moved\n\n" + "\n".join(lines) + "\n"


def moved_methods() -> dict[str, str]:
    """Return the old address of each method that shares a page: its section there."""
    table = (METHODS / "index.md").read_text(encoding="utf-8")
    shared = re.findall(r"\]\((\w+\.md#(\w+))\)", table)
    return {f"methods/{name}.md": target for target, name in shared}


def redirect_page(target: str) -> str:
    """Return a page that leads from an old address to the page that replaced it."""
    address = target.replace(".md", ".html")
    return (
        f'<meta http-equiv="refresh" content="0; url={address}">\n\n# Moved\n\n'
        f"This page is now [{target.removesuffix('.md')}]({target}).\n"
    )


def reference() -> str:
    """Return the page of the public names, by the task that each serves."""
    stub = (ROOT / "src/undeadzone/__init__.pyi").read_text(encoding="utf-8")
    names = re.findall(r"^from \.([\w.]+) import (\w+) as \w+$", stub, re.M)
    paths = [f"undeadzone.{module}.{name}" for module, name in names]
    names = re.findall(r"^\w+ = (undeadzone_\w+)\.(\w+)$", stub, re.M)
    paths += [f"{package}.{name}" for package, name in names]
    tasks: dict[str, list[str]] = {title: [] for title in TASKS.values()}
    for path in sorted(paths, key=lambda path: path.rsplit(".", 1)[1].lower()):
        served = max((start for start in TASKS if path.startswith(start)), key=len)
        tasks[TASKS[served]].append(f"::: {path}")
    parts = ["# API", "Everything here is `uz.NAME` after `import undeadzone as uz`."]
    for number, (title, entries) in enumerate(tasks.items()):
        # An element whose id is "exports" would look like a module loader to KaTeX.
        parts += [f"## {title} {{ #task-{number} }}", *entries]
    return "\n\n".join(parts) + "\n"
