"""Work in a process of its own: that it hangs, dies or takes all memory is not the end."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import traceback
from collections.abc import Iterator
from typing import Any


def tell_apart(values: Iterator[Any]) -> tuple[list[Any], int]:
    """What a process that begins as this one is tells of values; what it gives up is its own.

    Args:
        values: which are computed there, and told by JSON.

    Returns:
        Those that were told, and the signal or status that ended the process, 0 once all were.
    """
    sys.stdout.flush()
    with tempfile.TemporaryFile() as file:
        pid = os.fork()
        if not pid:
            code = 1
            try:
                for value in values:
                    file.write(json.dumps(value).encode() + b"\n")
                    file.flush()
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        _, status = os.waitpid(pid, 0)
        file.seek(0)
        told = list(map(json.loads, file))
    return told, abs(os.waitstatus_to_exitcode(status))
