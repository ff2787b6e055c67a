from .answer.result import Identified as Identified
from .answer.result import IdentifiedOutputs as IdentifiedOutputs
from .questions import identify as identify
