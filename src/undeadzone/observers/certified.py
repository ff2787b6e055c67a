"""Repaired observer: its innovation is formed on the branch that the sensor shows.

The mathematics is in docs/observer.md.
"""

from __future__ import annotations

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.adaptive.adaptation_laws import Adaptation, Gradient, read_initial_widths
from undeadzone.observers.adaptive.branch_observer import build_branch_observer
from undeadzone.observers.adaptive.gain import default_adaptation, innovation_gain
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_nonnegative, require_vector


class Certified(Options, frozen=True, kw_only=True, tag="certified"):
    """Measured-branch adaptive observer that replaces (16)-(25).

    Gains are continuous-time ones in either time.

    Example:
        >>> certified = uz.Certified(L=[1.0, 1.5], gamma=10.0)
        >>> certified.gamma
        10.0

    See Also:
        design, check, Luenberger

    Attributes:
        L: gains (n x p) [1/s x state/output], default along P^-1 C', so strong that a lasting error
            of the model moves z^ by half of it (always certified). For integrators, undamped and
            unstable poles, which no certificate covers: poles of A - L C of half the mean pole.
        gamma: adaptation gain, one or one per output [1/s] (default three mean poles of the plant,
            0 where no gain learns a width: an odd number of unstable poles, no integrator).
        design: a file saved by `Design.save`, in place of L and gamma. Its proof is checked again
            for the model.
        start: x^(0), one number or one per state.
        widths0: initial d_r^, d_l^, one number, [right, left], or one such pair per output [z].
        width_max: d_M per side, one or one per output [z] (default none). The estimates are
            projected onto [0, d_M].
        silence: use also that a censored sample bounds z (certified too, but its kink is not
            located, so that the integration error falls as h^2 only).
        adaptation: law for the widths, default the gradient (with one that is not constant there is
            no certificate).
    """

    L: Array | None = None
    gamma: Array | None = None
    design: str | None = None
    start: Array = 0.0
    widths0: Array = 0.0
    width_max: Array | None = None
    silence: bool = False
    adaptation: Adaptation = Gradient()

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model, continuous or sampled."""
        p = model.p
        L, gain = self._choose_gains(model)
        gamma = require_nonnegative("observer.gamma", gain, p, "one per output")
        widths, limit = read_initial_widths(self.widths0, self.width_max, p)
        start = require_vector("observer.start", self.start, model.n, "one per state")
        law = self.adaptation.build_law(model.Ts)
        return build_branch_observer(
            model, sensor, innovation_gain(L, model), gamma, start, widths, limit, self.silence, law
        )

    def _choose_gains(self, model: System) -> tuple[Array | None, Array]:
        """Return (L, gamma) as given, or those of the design.

        Raises InputError, ProofError.
        """
        if self.design is None:
            return self.L, default_adaptation(model) if self.gamma is None else self.gamma
        if self.L is not None or self.gamma is not None:
            raise InputError(
                "observer.design: it brings L and gamma. Give either the design or these"
            )
        return _load_design_gains(self.design, model)


def _load_design_gains(path: str, model: System) -> tuple[Floats, Floats]:
    """Return (L, gamma) of a design with a valid proof for the model.

    Raises FileError, ProofError.
    """
    from undeadzone.analysis.certificate.design_file import Design

    design = Design.load(path)
    design.require_proof(model.linear, model.Ts, f"observer.design: {path}")
    return design.L, design.gamma
