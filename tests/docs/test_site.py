"""The built site, and pages that commands write, in a browser: nothing hidden, nothing raw.

The tutorials are not run here (test_tutorials.py does), their code stands on the pages.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import once
import undeadzone_paper
from browser import Browser, browser
from commands import undeadzone
from documents import ROOT
from further import further
from requirements import require

SCREENS = (390, 1280)
READY = "document.readyState === 'complete' && location.href !== 'about:blank'"
# Beyond the screen without a way to scroll there, texts that nobody typeset, pictures that are not,
# and on a wide screen formulas that scroll.
FAULTS = r"""
(() => {
  const width = document.documentElement.clientWidth, faults = [];
  const whole = document.querySelector('.md-content') || document.body;
  const scrolls = element => {
    for (let e = element.parentElement; e; e = e.parentElement)
      if (['auto', 'scroll'].includes(getComputedStyle(e).overflowX)) return true;
    return false;
  };
  if (document.documentElement.scrollWidth > width + 1) faults.push('the page is too wide');
  for (const e of whole.querySelectorAll('*')) {
    if (e.closest('.katex-mathml') || (e.closest('svg') && e.tagName !== 'svg')) continue;
    const box = e.getBoundingClientRect();
    if (box.width && box.height && (box.right > width + 1 || box.left < -1) && !scrolls(e))
      faults.push(`hidden: ${e.tagName} ${e.textContent.trim().slice(0, 40)}`);
  }
  const texts = document.createTreeWalker(whole, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode;
    if (text.parentElement.closest('pre, code, script, style, .katex, .arithmatex')) continue;
    if (/\\[a-zA-Z(]|[_^]\{|\$[^$]+\$/.test(text.data))
      faults.push(`raw: ${text.data.trim().slice(0, 60)}`);
  }
  if (width > 1000)
    for (const formula of document.querySelectorAll('.katex-display'))
      if (formula.scrollWidth > formula.clientWidth + 1)
        faults.push(`cut: ${formula.scrollWidth - formula.clientWidth} px of `
          + formula.querySelector('annotation').textContent.trim().slice(0, 60));
  if (document.querySelector('.katex-error')) faults.push('a formula with an error');
  for (const image of document.images)
    if (image.complete && !image.naturalWidth) faults.push(`no picture: ${image.src}`);
  return faults.slice(0, 5);
})()
"""


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser with one page."""
    require("browser", [] if browser() else ["chromium"])
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def found_faults(screen: Browser, pages: list[Path]) -> dict[str, Any]:
    """Return the faults of pages by name and width of the screen, which widens under a page."""
    found = {}
    for page in pages:
        for width in SCREENS:
            screen.sized(width, 900, idle=0)
            if width == SCREENS[0]:
                screen.open(page.as_uri(), READY)
            faults = screen.value(FAULTS)
            if faults:  # a drawer may still be moving
                screen.sized(width, 900)
                faults = screen.value(FAULTS)
            if faults:
                found[f"{page.name} at {width}"] = faults
    return found


def test_faults_are_seen(screen: Browser, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        "<meta name='viewport' content='width=device-width'><p>raw $x_{1}$"
        "<div style='overflow: hidden'><p style='width: 600px'>wide</p></div>"
        "<div style='overflow: auto'><p style='width: 600px'>scrolls</p></div>"
        "<img src='none.png'>"
    )
    screen.sized(SCREENS[0], 900)
    screen.open(page.as_uri(), READY)
    words = [fault.split(":")[0] for fault in screen.value(FAULTS)]
    assert sorted(words) == ["hidden", "no picture", "raw"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it, in strict mode, without the outputs of tutorials."""
    require(
        "docs", [name for name in ("mkdocs", "material", "mkdocstrings") if not find_spec(name)]
    )
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    out = tmp_path_factory.mktemp("site")
    names = {path.stem: path.read_text() for path in (ROOT / "docs/tutorials").glob("*.py")}
    idle = ModuleType("tutorials")
    vars(idle)["NAMES"] = tuple(sorted(names))
    vars(idle)["pages"] = lambda folder: {
        f"{name}.md": f"# {name}\n\n```python\n{text}\n```\n" for name, text in names.items()
    }
    before = sys.modules.get("tutorials")
    sys.modules["tutorials"] = idle
    try:
        config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(out), strict=True)
        build(config)
    finally:
        sys.modules.pop("tutorials")
        if before is not None:
            sys.modules["tutorials"] = before
    return out


def test_every_page_of_the_site_is_whole_on_a_telephone(site: Path, screen: Browser) -> None:
    pages = [page for page in sorted(site.rglob("*.html")) if "files" not in page.parts]
    pages = [page for page in pages if 'http-equiv="refresh"' not in page.read_text()]
    if not (ROOT / "docs/site/assets/katex/katex.min.js").is_file():
        require("docs", ["KaTeX (docs/site/vendor.sh)"])
    assert len(pages) > 90
    assert found_faults(screen, pages) == {}


def test_old_addresses_lead_on(site: Path) -> None:
    for old in ("house", "glossary", "methods/tobit"):
        assert 'http-equiv="refresh"' in (site / f"{old}.html").read_text()


def test_every_row_of_the_api_has_a_name(site: Path) -> None:
    text = (site / "api.html").read_text()
    cells = re.findall(r'<tr class="doc-section-item">\s*<td>(.*?)</td>', text, re.S)
    names = [re.sub(r"<[^>]*>|\s", "", cell) for cell in cells]
    assert len(names) > 700
    assert [name for name in names if re.search(r",$|^\(|^$", name)] == []


SCENARIO, LOG = "examples/asymmetric_noise.toml", "examples/samples.csv"
REPORTS = {
    "run": ["run", SCENARIO],
    "arm": ["run", "examples/two_link.toml"],
    "check": ["check", SCENARIO],
    "estimate": ["estimate", SCENARIO, LOG],
    "identify": ["identify", LOG, "--order", "3", "--delay", "0"],
    "ensemble": ["ensemble", "examples/ensemble.toml", "--runs", "40"],
    "tune": ["tune", "examples/tune.toml", "--runs", "4", "--budget", "4"],
    "arena": ["arena", SCENARIO, "--methods", "censored,ekf", "--seeds", "1"],
    "design": ["design", SCENARIO],
    "paper": ["paper"],
}


@pytest.mark.parametrize(
    "name", ["run", "identify", *further(*sorted(REPORTS.keys() - {"run", "identify"}))]
)
def test_a_report_is_whole_on_a_telephone(
    name: str, screen: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    once.in_haste(monkeypatch)
    monkeypatch.setattr(undeadzone_paper, "audit", lambda progress: once.audit()[0])
    done = undeadzone(*REPORTS[name], "--out", str(tmp_path), cwd=ROOT)
    assert done.returncode in (0, 1), done.stderr
    assert found_faults(screen, [tmp_path / "report.html"]) == {}


def test_pages_of_ranked_loops_are_whole_on_a_telephone(screen: Browser, tmp_path: Path) -> None:
    for name in ("FIC1", "FIC1_0613", "LIC20102-of-the-second-column"):
        (tmp_path / f"{name}.csv").symlink_to(ROOT / "docs/trades/valve.csv")
    out = tmp_path / "out"
    done = undeadzone("loops", tmp_path, "--out", str(out))
    assert done.returncode == 0, done.stderr
    pages = sorted(out.rglob("report.html"))
    assert len(pages) == 3
    assert found_faults(screen, pages) == {}


def test_the_live_page_is_whole_on_a_telephone(screen: Browser, tmp_path: Path) -> None:
    live = tmp_path / "live.html"
    assert not undeadzone("export", SCENARIO, "--to", "page", "--out", str(live)).returncode
    assert found_faults(screen, [live]) == {}
