import undeadzone_design
import undeadzone_export
import undeadzone_identify
import undeadzone_studies

from . import compensators as compensators
from . import controllers as controllers
from . import observers as observers
from . import plants as plants
from . import signals as signals
from .analysis.certificate.design_file import Design as Design
from .analysis.certificate.passivity import Certificate as Certificate
from .analysis.certificate.passivity import certify as certify
from .analysis.error_dynamics import Dynamics as Dynamics
from .compensators import NoInverse as NoInverse
from .compensators import SmoothZoneInverse as SmoothZoneInverse
from .compensators import ZoneInverse as ZoneInverse
from .controllers import LQG as LQG
from .controllers import LQR as LQR
from .controllers import PD as PD
from .controllers import PID as PID
from .controllers import ComputedTorque as ComputedTorque
from .controllers import LinearController as LinearController
from .controllers import Robust as Robust
from .controllers import StateFeedback as StateFeedback
from .errors import ClusterError as ClusterError
from .errors import FileError as FileError
from .errors import InputError as InputError
from .errors import ProofError as ProofError
from .errors import ShapeError as ShapeError
from .errors import StepError as StepError
from .errors import StructureError as StructureError
from .errors import TrackingError as TrackingError
from .errors import UndeadzoneError as UndeadzoneError
from .interfaces import Estimate as Estimate
from .linalg.matrices import Matrices as Matrices
from .nonlinearities.actuator import Actuator as Actuator
from .nonlinearities.actuator import ActuatorModel as ActuatorModel
from .nonlinearities.sensor import Sensor as Sensor
from .numerics.deadzone_update import DeadzoneMemory as DeadzoneMemory
from .numerics.deadzone_update import DeadzoneUpdate as DeadzoneUpdate
from .numerics.deadzone_update import deadzone_update as deadzone_update
from .observers import Auto as Auto
from .observers import Censored as Censored
from .observers import Certified as Certified
from .observers import Extended as Extended
from .observers import FullState as FullState
from .observers import HighGain as HighGain
from .observers import Kalman as Kalman
from .observers import Luenberger as Luenberger
from .observers import Oracle as Oracle
from .observers.adaptive.adaptation_laws import EModification as EModification
from .observers.adaptive.adaptation_laws import Gradient as Gradient
from .observers.adaptive.adaptation_laws import LeastSquares as LeastSquares
from .observers.adaptive.adaptation_laws import Normalised as Normalised
from .observers.adaptive.adaptation_laws import Sigma as Sigma
from .observers.filtering.prior import Assumptions as Assumptions
from .plants.build import system as system
from .plants.interop import from_control as from_control
from .plants.interop import from_scipy as from_scipy
from .plants.interop import to_scipy as to_scipy
from .plants.options import URDF as URDF
from .plants.options import ElasticJoint as ElasticJoint
from .plants.options import OneLink as OneLink
from .plants.options import Plant as Plant
from .plants.options import SecondOrder as SecondOrder
from .plants.options import TransferFunction as TransferFunction
from .plants.options import TwoLink as TwoLink
from .plants.options import to_control as to_control
from .plants.region import Box as Box
from .plants.region import Region as Region
from .plants.robots.geared import Gears as Gears
from .plants.system import System as System
from .registry import Options as Options
from .report.plot import plot as plot
from .results.estimation import Estimation as Estimation
from .results.run import Run as Run
from .scenario.ensemble_table import Distribution as Distribution
from .scenario.ensemble_table import Vary as Vary
from .scenario.operating_point import OperatingPoint as OperatingPoint
from .scenario.reader import read as read
from .scenario.schema import Model as Model
from .scenario.schema import Scenario as Scenario
from .scenario.schema import Simulation as Simulation
from .scenario.schema import Units as Units
from .scenario.tune_table import Range as Range
from .scenario.tune_table import Tune as Tune
from .signals.exosystem import Random as Random
from .signals.exosystem import Samples as Samples
from .signals.exosystem import Sine as Sine
from .signals.exosystem import Sines as Sines
from .signals.exosystem import Step as Step
from .signals.exosystem import Tone as Tone
from .signals.exosystem import Trapezoid as Trapezoid
from .signals.paths import Circle as Circle
from .signals.paths import FigureEight as FigureEight
from .signals.paths import Quintic as Quintic
from .signals.paths import Swing as Swing
from .simulation.estimate import estimate as estimate
from .simulation.online import Online as Online
from .simulation.simulate import compare as compare
from .simulation.simulate import simulate as simulate

# What other packages register under `undeadzone.names`.
Check = undeadzone_design.Check
Ensemble = undeadzone_studies.Ensemble
Exported = undeadzone_export.Exported
Fitted = undeadzone_identify.Fitted
Identified = undeadzone_identify.Identified
IdentifiedAtRest = undeadzone_identify.IdentifiedAtRest
IdentifiedLoop = undeadzone_identify.IdentifiedLoop
IdentifiedMotion = undeadzone_identify.IdentifiedMotion
IdentifiedOutputs = undeadzone_identify.IdentifiedOutputs
Sweep = undeadzone_studies.Sweep
Tuned = undeadzone_studies.Tuned
Ultimate = undeadzone_design.Ultimate
Weights = undeadzone_design.Weights
certified_radius = undeadzone_design.certified_radius
certify_on = undeadzone_design.certify_on
check = undeadzone_design.check
closed_loop = undeadzone_design.closed_loop
decay_limit = undeadzone_design.decay_limit
design = undeadzone_design.design
design_on = undeadzone_design.design_on
export = undeadzone_export.export
fit = undeadzone_identify.fit
identify = undeadzone_identify.identify
prove = undeadzone_export.prove
replay_run = undeadzone_studies.replay_run
run_ensemble = undeadzone_studies.run_ensemble
sweep = undeadzone_studies.sweep
tune = undeadzone_studies.tune
ultimate_bound = undeadzone_design.ultimate_bound

__version__: str
