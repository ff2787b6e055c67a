from .fitting.estimates import fit as fit
from .fitting.result import Fitted as Fitted
from .pipeline import identify as identify
from .results.at_rest import IdentifiedAtRest as IdentifiedAtRest
from .results.loop import IdentifiedLoop as IdentifiedLoop
from .results.lost_motion import IdentifiedMotion as IdentifiedMotion
from .results.result import Identified as Identified
from .results.result import IdentifiedOutputs as IdentifiedOutputs
