"""Figures 1 and 2: arrows are what the graph depends on."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from documents import EXAMPLES
from undeadzone.scenario.reader import read
from undeadzone_paper.diagrams import (
    CONTROLLER,
    INVERSE,
    OBSERVER,
    OUT,
    PATHS,
    PLACES,
    PLANT,
    REFERENCE,
    SENSOR,
    plot_diagrams,
    trace_diagram,
)
from undeadzone_paper.example import example_as_printed, example_as_repaired

EXAMPLE = EXAMPLES / "paper_printed.toml"


def test_as_printed_the_observer_hears_nothing_of_u_and_no_state_is_fed_back() -> None:
    arrows = {arrow[:2]: arrow.signals for arrow in trace_diagram(example_as_printed(5.0)).arrows}
    assert (CONTROLLER, OBSERVER) not in arrows
    assert arrows[OBSERVER, CONTROLLER] == ("y \u2212 \u0177",)
    assert arrows[REFERENCE, CONTROLLER] == ("r",)
    assert arrows[SENSOR, OBSERVER] == ("y",)
    assert arrows[PLANT, SENSOR] == ("z",)
    assert (INVERSE, OUT) in arrows


def test_with_B_u_an_arrow_from_u_appears() -> None:
    printed = example_as_printed(5.0)
    fed = msgspec.structs.replace(printed.observer, feed_input=True)
    arrows = trace_diagram(msgspec.structs.replace(printed, observer=fed)).arrows
    assert (CONTROLLER, OBSERVER, ("u",)) in arrows


def test_repaired_the_state_is_fed_back_and_the_side_is_read() -> None:
    arrows = {arrow[:2]: arrow.signals for arrow in trace_diagram(example_as_repaired(5.0)).arrows}
    assert arrows[OBSERVER, CONTROLLER] == ("x\u0302",)
    assert arrows[REFERENCE, CONTROLLER] == ("x_ref", "u_ff")
    assert arrows[SENSOR, OBSERVER] == ("y", "side")
    assert (CONTROLLER, OBSERVER) in arrows


def test_law_29_needs_more_than_the_innovation() -> None:
    arrows = {arrow[:2]: arrow.signals for arrow in trace_diagram(read(EXAMPLE)).arrows}
    assert {"d\u0302 right", "d\u0302 left"} < set(arrows[OBSERVER, CONTROLLER])
    assert arrows.keys() <= PATHS.keys()


@pytest.mark.parametrize(("number", "blocks"), [(1, 4), (2, 6)])
def test_a_diagram_shows_its_blocks(number: int, blocks: int) -> None:
    from matplotlib.patches import Rectangle

    figure = plot_diagrams(number, {"one": example_as_repaired(5.0)})
    (axes,) = figure.axes
    boxes = [patch for patch in axes.patches if type(patch) is Rectangle]
    assert len(boxes) == blocks
    middles = [box.get_center() for box in boxes]
    assert all(any(np.allclose(one, place) for place in PLACES.values()) for one in middles)
    texts = {text.get_text() for text in axes.texts}
    assert ("observer\ncertified" in texts) == (number == 2)
    assert "u" in texts
