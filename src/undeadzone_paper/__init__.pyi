from .audit import Paper as Paper
from .audit import audit as audit
from .report import write as write

__all__ = ["Paper", "audit", "write"]
