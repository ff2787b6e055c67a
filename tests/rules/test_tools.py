"""A test whose program is missing skips by its name, or fails where that is required."""

from __future__ import annotations

import pytest

from tools import require


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UNDEADZONE_REQUIRE", raising=False)
    require("emulator", [])
    with pytest.raises(pytest.skip.Exception, match="emulator: not installed: qemu, gcc"):
        require("emulator", ["qemu", "gcc"])
    monkeypatch.setenv("UNDEADZONE_REQUIRE", "fmu,emulator")
    with pytest.raises(pytest.fail.Exception, match="emulator: not installed: qemu"):
        require("emulator", ["qemu"])
    with pytest.raises(pytest.skip.Exception):
        require("browser", ["chromium"])
