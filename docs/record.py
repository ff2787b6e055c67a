"""Records the live page as the front picture: python docs/record.py writes docs/figures/live.gif.

A headless browser of the Chromium family moves the sliders of docs/live.html as a reader would.
"""

from __future__ import annotations

import io
import itertools
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

DOCS: Final = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent))
from tests.browser import Browser, browser  # noqa: E402  tests are no package that is installed

WIDTH, HEIGHT = 1085, 760  # of the screen
SHOWN = (814, 570)  # of the picture
FRAME = 110  # [ms]
PAUSE = 1400  # [ms] at the first and the last frame
# What is moved: the slider's place on the page, and its values in turn.
MOVES: Final = ((0, (1.0, 1.8, 0.3, 1.0)), (1, (0.6, 1.6, 0.6)), (2, (3.0, 1.6, 3.0)))
STEPS = 6  # frames between two values
MOVE: Final = """(() => {
  const slider = document.querySelectorAll("#sliders input[type=range]")[%d];
  slider.value = %r;
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
})()"""


def values() -> Iterator[tuple[int, float]]:
    """Each slider's place and value, frame by frame."""
    for place, stops in MOVES:
        for start, end in itertools.pairwise(stops):
            for value in np.linspace(start, end, STEPS + 1)[1:]:
                yield place, round(float(value), 3)


def frames() -> Iterator[Image.Image]:
    """Pictures of the page."""
    with tempfile.TemporaryDirectory() as profile, Browser(Path(profile)) as page:
        page.open((DOCS / "live.html").resolve().as_uri())
        yield taken(page)
        for place, value in values():
            page.value(MOVE % (place, value))
            yield taken(page)


def taken(page: Browser) -> Image.Image:
    """A picture of the page now."""
    whole = Image.open(io.BytesIO(page.looks(WIDTH, HEIGHT))).convert("RGB")
    wide = min(WIDTH, whole.width)  # less a scroll bar
    return whole.crop((0, 0, wide, HEIGHT)).resize(SHOWN, Image.Resampling.LANCZOS)


def main() -> int:
    """Write the picture."""
    if browser() is None:
        print("docs/record.py: needs chromium (make tools)", file=sys.stderr)  # noqa: T201
        return 2
    first, *rest = frames()
    palette = first.quantize(64, dither=Image.Dither.NONE)
    shown = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in (first, *rest)]
    times = [PAUSE, *[FRAME] * (len(rest) - 1), PAUSE]
    path = DOCS / "figures" / "live.gif"
    shown[0].save(
        path, save_all=True, append_images=shown[1:], duration=times, loop=0, optimize=True
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
