"""The paper's example as printed and as repaired.

The audit holds its variants, facts, figures 3-8, its claims judged and its equations placed.
"""

from undeadzone_paper.audit import Paper, audit
from undeadzone_paper.report import write

__all__ = ["Paper", "audit", "write"]
