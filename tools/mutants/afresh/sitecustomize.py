"""Every Python that starts with this folder in PYTHONPATH imports a module changed.

MUTANT_MODULE is its name, and MUTANT_TEXT the path of the text that it gets. No bytecode is kept.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import CodeType, ModuleType


class _Changed(importlib.machinery.SourceFileLoader):
    """A loader of a file that executes another text."""

    def get_code(self, fullname: str) -> CodeType:
        return compile(Path(os.environ["MUTANT_TEXT"]).read_text("utf-8"), self.path, "exec")


class _Finder:
    """A finder of the module that is changed, and of no other."""

    @staticmethod
    def find_spec(
        fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != os.environ.get("MUTANT_MODULE"):
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.origin is None:
            return None
        return importlib.util.spec_from_file_location(
            fullname, spec.origin, loader=_Changed(fullname, spec.origin)
        )


sys.meta_path.insert(0, _Finder)
