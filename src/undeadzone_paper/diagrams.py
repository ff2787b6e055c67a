"""Figures 1 and 2 of the paper, the block diagrams, drawn from the graph of the loop that runs.

An arrow is drawn if the results of the block at its end depend on the signal in the graph.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import casadi as ca

from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Reading, require_graph
from undeadzone.nonlinearities.sensor import branch
from undeadzone.nonlinearities.sensor import zone as where
from undeadzone.report import ink
from undeadzone.report.style import create_panels
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util import tree
from undeadzone_paper.equations import DIAGRAMS, read_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HATS: Final = {
    "x": "x\u0302",
    "z": "z\u0302",
    "right": "d\u0302 right",
    "left": "d\u0302 left",
    "z_inverse": "y + \u03c7d\u0302",
    "innovation": "y \u2212 \u0177",
}
"""What figures call the fields of an estimate."""

HALF: Final = (0.75, 0.3)  # of a block, width and height
_LAYOUT: Final = read_words("diagrams.toml")
PLACES: Final[dict[str, tuple[float, float]]] = _LAYOUT["places"]
REFERENCE, CONTROLLER, PLANT, SENSOR, OBSERVER, INVERSE = PLACES
OUT = "out"
PATHS: Final[dict[tuple[str, str], dict[str, Any]]] = {
    (row["from"], row["to"]): row for row in _LAYOUT["arrows"]
}


class Arrow(NamedTuple):
    """Arrow of a block diagram: its ends, and the names of its signals."""

    source: str
    target: str
    signals: tuple[str, ...]


class Diagram(NamedTuple):
    """Block diagram of a loop: what its blocks are called, and its arrows."""

    names: dict[str, str]
    arrows: list[Arrow]


def trace_diagram(scenario: Scenario) -> Diagram:
    """Trace the blocks and arrows of a scenario's loop by its graph, with all numbers put in."""
    problem = resolve_scenario(scenario)
    plant = problem.plant
    observer = require_graph(problem.observer)
    law = problem.controller
    u = ca.SX.sym("u", plant.m)
    y, side, z = (ca.SX.sym(name, plant.p) for name in ("y", "side", "z"))
    _, s = tree.create_symbols(observer.init(observer.params), "s")
    following, estimate = observer.step(observer.params, s, u, Reading(y, side))
    symbols = {name: ca.SX.sym(name, *getattr(estimate, name).shape) for name in HATS}
    estimated = dict(zip(HATS.values(), symbols.values(), strict=True))
    sizes = {"r": len(problem.tracked), "x_ref": plant.n, "u_ff": plant.m}
    targets = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    _, memory = tree.create_symbols(law.init(law.params), "c")
    target = Target(**targets, plan=ca.SX.zeros(law.plan_size))
    answer = law.step(law.params, memory, estimate._replace(**symbols), target)
    zone = problem.sensor
    read = branch(z, where(z, zone.right, zone.left), zone.right, zone.left, zone.slope, zone.kind)
    sources = {
        REFERENCE: targets,
        CONTROLLER: {"u": u},
        PLANT: {"z": z},
        SENSOR: {"y": y, "side": side},
        OBSERVER: {**estimated, "d\u0302": tree.stack_leaves(s)},
    }
    results = {
        CONTROLLER: tree.stack_leaves(answer),
        PLANT: plant.move(plant.params, ca.SX.zeros(plant.n), u),
        SENSOR: read,
        OBSERVER: tree.stack_leaves(following),
        INVERSE: estimate.z_inverse,
    }
    arrows = {
        ends: _signals_in(results[ends[1]], sources[ends[0]]) for ends in PATHS if OUT not in ends
    }
    arrows |= {(SENSOR, OUT): ("y",), (INVERSE, OUT): (HATS["z_inverse"],)}
    tags = [str(part.__struct_config__.tag) for part in (scenario.controller, scenario.observer)]
    kinds = dict(zip((CONTROLLER, OBSERVER, SENSOR), (*tags, zone.kind), strict=True))
    names = {name: f"{name}\n{kinds.get(name, '')}".strip() for name in PLACES}
    return Diagram(names, [Arrow(*ends, named) for ends, named in arrows.items() if named])


def _signals_in(expression: Any, symbols: dict[str, ca.SX]) -> tuple[str, ...]:
    """Return the names of the symbols on which an expression depends."""
    return tuple(
        name for name, symbol in symbols.items() if ca.depends_on(ca.SX(expression), symbol)
    )


def plot_diagrams(number: int, loops: Mapping[str, Scenario]) -> Figure:
    """Plot figure 1 or 2 of the paper for one loop or several.

    Args:
        number: 1, without observer, or 2, with it
        loops: scenarios by the titles of their panels
    """
    rows = [[name] for name in loops]
    height = (1.1, 2.4)[number - 1]
    sketch, panels = create_panels(rows, f"Figure {number}: {DIAGRAMS[number]}", height=height)
    for name, scenario in loops.items():
        blocks = [block for block in PLACES if number == 2 or block not in (OBSERVER, INVERSE)]
        _draw_diagram(panels[name], trace_diagram(scenario), name, blocks)
    return sketch


def _draw_diagram(axes: Axes, diagram: Diagram, title: str, blocks: list[str]) -> None:
    """Draw blocks of a diagram, and the arrows between them."""
    from matplotlib.patches import Rectangle

    axes.set_axis_off()
    low = min(PLACES[key][1] for key in blocks) - 0.6
    axes.set(xlim=(0.0, 11.6), ylim=(low, 2.6))
    axes.set_title(title, loc="left", fontsize=9.5, fontweight="bold")
    wide, high = HALF
    for key in blocks:
        x, y = PLACES[key]
        box = Rectangle((x - wide, y - high), 2 * wide, 2 * high, fill=False, edgecolor=ink.TRUTH)
        axes.add_patch(box)
        axes.text(x, y, diagram.names[key], ha="center", va="center")
    for arrow in diagram.arrows:
        if {arrow.source, arrow.target} <= {*blocks, OUT}:
            _draw_arrow(axes, arrow)


def _draw_arrow(axes: Axes, arrow: Arrow) -> None:
    """Draw an arrow along its corners, with the names of its signals."""
    path = PATHS[arrow.source, arrow.target]
    corners = path["corners"]
    axes.plot(*zip(*corners, strict=True), color=ink.ESTIMATE, linewidth=1.0)
    head = {"arrowstyle": "-|>", "color": ink.ESTIMATE, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", corners[-1], corners[-2], arrowprops=head)
    x, y = path["word"]
    axes.text(x, y, ", ".join(arrow.signals), color=ink.ESTIMATE, **path["align"])
