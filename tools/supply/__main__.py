"""What undeadzone is made of.

python -m tools.supply hashes        hashes of what constraints.txt names, asked of pip's index
python -m tools.supply sbom WHEEL    a bill of materials (CycloneDX) beside a wheel
python -m tools.supply sizes         what an installation takes, by distribution
"""

from __future__ import annotations

import sys
from pathlib import Path

from tools.supply import hashes, sbom, sizes


def main() -> int:
    match sys.argv[1:]:
        case ["hashes"]:
            print("\n".join(map(str, hashes.write())))
        case ["sbom", wheel]:
            print(sbom.write(Path(wheel)))
        case ["sizes"]:
            print(sizes.table())
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
