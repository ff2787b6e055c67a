from .computed_torque import ComputedTorque as ComputedTorque
from .linear_controller import LinearController as LinearController
from .lqg import LQG as LQG
from .lqr import LQR as LQR
from .pd import PD as PD
from .pid import PID as PID
from .state_feedback import Robust as Robust
from .state_feedback import StateFeedback as StateFeedback
