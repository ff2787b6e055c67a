"""Ask each case again and print what moved; or freeze today's answers, with a reason."""

from __future__ import annotations

import os
import sys

# before NumPy is imported: matrices here are small
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if __name__ == "__main__":
    from tests.reference.command import main

    sys.exit(main(sys.argv[1:]))
