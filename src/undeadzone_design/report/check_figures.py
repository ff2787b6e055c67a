"""First figure of a check: its certificate, or the parameters that the readings identify."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate
from undeadzone.errors import InputError
from undeadzone_design.report.gain_figures import draw_width_region, plot_ellipses
from undeadzone_design.report.proof_figures import draw_least_real_part, plot_positive_realness
from undeadzone_design.synthesis.assessment import Assessment
from undeadzone_design.synthesis.check import Check

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_check(check: Check) -> Figure:
    """Return the certificate over frequency, or ellipses of the widths. Raises InputError."""
    proof = _find_proof(check.assessment)
    return plot_ellipses(check.assessment) if proof is None else plot_positive_realness(proof)


def draw_check_panel(axes: Axes, check: Check) -> None:
    """Draw the least real part over frequency, or the region of the widths. Raises InputError."""
    proof = _find_proof(check.assessment)
    if proof is None:
        draw_width_region(axes, check.assessment, 0)
    else:
        draw_least_real_part(axes, proof)


def _find_proof(of: Assessment) -> Certificate | None:
    """Return the certificate to draw, or None if the widths are to be drawn. Raises InputError.

    A jump sensor's widths have no ellipse.
    """
    proof = None if of.gains is None else of.gains.certificate
    if proof is not None and np.isfinite(proof.margin):
        return proof
    if of.problem.sensor.kind != "deadzone":
        raise InputError("plot: this check has no certificate, and nothing that can be drawn")
    return None
