"""Colours of figures, one per quantity.

They are those of Okabe and Ito, which colour-blind readers can distinguish.
"""

from typing import Final

TRUTH: Final = "#1a1a1a"
ESTIMATE: Final = "#0072b2"
READING: Final = "#e69f00"
REFERENCE: Final = "#009e73"
PRINTED: Final = "#d55e00"
OTHER: Final = "#cc79a7"
ZONE: Final = "#8a8f98"
FORBIDDEN: Final = "#f3d9cc"  # region of unstable poles, or of 1 + G not positive real
