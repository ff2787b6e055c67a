"""The catalogue of controllers: one file each. To add one, write its file and name its options class here."""

from undeadzone.controllers.interface import Controller
from undeadzone.controllers.pd import PD
from undeadzone.controllers.state_feedback import Robust, StateFeedback

ControllerOptions = StateFeedback | PD

__all__ = ["PD", "Controller", "ControllerOptions", "Robust", "StateFeedback"]
