"""Shared by the tests of the paper's audit."""

from __future__ import annotations

import pytest

import once
from undeadzone_paper import Paper


@pytest.fixture(scope="session")
def paper() -> Paper:
    """Return the audit of the paper, which one process computes once."""
    return once.audit()[0]
