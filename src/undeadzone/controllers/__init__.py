"""The catalogue of controllers: one file each.

To add one, write its file and name its options class here.
"""

from undeadzone.controllers.computed_torque import ComputedTorque
from undeadzone.controllers.fuzzy_feedback import FuzzyFeedback
from undeadzone.controllers.gravity_pd import GravityPD
from undeadzone.controllers.linear_controller import LinearController
from undeadzone.controllers.lqg import LQG
from undeadzone.controllers.lqr import LQR
from undeadzone.controllers.pd import PD
from undeadzone.controllers.pid import PID
from undeadzone.controllers.rbf_feedback import RBFFeedback
from undeadzone.controllers.robust_adaptive import RobustAdaptive
from undeadzone.controllers.sliding_mode import SlidingMode
from undeadzone.controllers.state_feedback import Robust, StateFeedback
from undeadzone.controllers.taylor_feedback import TaylorFeedback
from undeadzone.interfaces import Controller, Plan

ControllerOptions = (
    StateFeedback
    | PD
    | SlidingMode
    | FuzzyFeedback
    | RBFFeedback
    | TaylorFeedback
    | ComputedTorque
    | GravityPD
    | LQR
    | LQG
    | PID
    | LinearController
    | RobustAdaptive
)

__all__ = [
    "LQG",
    "LQR",
    "PD",
    "PID",
    "ComputedTorque",
    "Controller",
    "ControllerOptions",
    "FuzzyFeedback",
    "GravityPD",
    "LinearController",
    "Plan",
    "RBFFeedback",
    "Robust",
    "RobustAdaptive",
    "SlidingMode",
    "StateFeedback",
    "TaylorFeedback",
]
