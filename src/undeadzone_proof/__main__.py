"""Run the checker as `python -m undeadzone_proof FILE [SOURCE.c]`."""

import sys

from undeadzone_proof import main

sys.exit(main(sys.argv[1:]))
