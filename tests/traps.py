"""What strangers leave in a folder, and how a shell starts a command there."""

from __future__ import annotations

import sys

COMMAND = [
    sys.executable,
    "-P",
    "-c",
    "import sys; sys.argv[0] = 'undeadzone'; from undeadzone.cli import main; main()",
]
SHORT = """title = "short"
plant = { A = [[-1.0]], B = [[1.0]], C = [[1.0]] }
sensor = { right = 0.4, left = 0.3 }
reference = { kind = "sine", amplitude = 2.0, frequency = 1.0 }
observer = { method = "kalman", right = [0.1, 1.0] }
controller = { method = "state_feedback", poles = [-6.0] }
simulation = { duration = 0.2, step = 1e-2, time = "sampled" }
"""
TRAP = 'open("RAN", "w").close()\n'
TRAPS = ("pickle", "socket", "struct", "random", "numpy", "undeadzone_arena", "sitecustomize")
