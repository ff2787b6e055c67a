"""Programs that some tests need: they skip by name, or fail where these are required."""

from __future__ import annotations

import os

import pytest


def require(group: str, missing: list[str]) -> None:
    """Skip the test that calls this, by the names of what is missing.

    Where UNDEADZONE_REQUIRE names the group (emulator, fmu, browser) it fails instead.
    """
    if not missing:
        return
    message = f"{group}: not installed: {', '.join(missing)}"
    if group in os.environ.get("UNDEADZONE_REQUIRE", "").split(","):
        pytest.fail(message)
    pytest.skip(message)
