"""The catalogue of observers: one file each.

To add one, write its file and name its options class here.
"""

from undeadzone.interfaces import Estimate, NumericObserver, Observer, Reading
from undeadzone.observers.adaptive_inverse import AdaptiveInverse
from undeadzone.observers.auto import Auto
from undeadzone.observers.censored import Censored
from undeadzone.observers.certified import Certified
from undeadzone.observers.ekf import EKF
from undeadzone.observers.extended import Extended
from undeadzone.observers.full_state import FullState
from undeadzone.observers.fuzzy_residual import FuzzyResidual
from undeadzone.observers.high_gain import HighGain
from undeadzone.observers.interval import Interval
from undeadzone.observers.inverse_network import InverseNetwork
from undeadzone.observers.kalman import Kalman
from undeadzone.observers.luenberger import Luenberger
from undeadzone.observers.moving_horizon import MovingHorizon
from undeadzone.observers.oracle import Oracle
from undeadzone.observers.particle import ParticleFilter
from undeadzone.observers.printed import Printed
from undeadzone.observers.rbf_residual import RBFResidual
from undeadzone.observers.robust_gradient import RobustGradient
from undeadzone.observers.super_twisting import SuperTwisting
from undeadzone.observers.taylor_residual import TaylorResidual
from undeadzone.observers.ukf import UKF
from undeadzone.observers.walcott_zak import WalcottZak

ObserverOptions = (
    Auto
    | Certified
    | Kalman
    | Censored
    | Extended
    | Luenberger
    | Oracle
    | FullState
    | Printed
    | EKF
    | UKF
    | ParticleFilter
    | MovingHorizon
    | WalcottZak
    | SuperTwisting
    | HighGain
    | Interval
    | AdaptiveInverse
    | RobustGradient
    | FuzzyResidual
    | RBFResidual
    | TaylorResidual
    | InverseNetwork
)

__all__ = [
    "EKF",
    "UKF",
    "AdaptiveInverse",
    "Auto",
    "Censored",
    "Certified",
    "Estimate",
    "Extended",
    "FullState",
    "FuzzyResidual",
    "HighGain",
    "Interval",
    "InverseNetwork",
    "Kalman",
    "Luenberger",
    "MovingHorizon",
    "NumericObserver",
    "Observer",
    "ObserverOptions",
    "Oracle",
    "ParticleFilter",
    "Printed",
    "RBFResidual",
    "Reading",
    "RobustGradient",
    "SuperTwisting",
    "TaylorResidual",
    "WalcottZak",
]
