"""Versions of the packages that decide the last bits of results."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

import undeadzone

PACKAGES = ("casadi", "llvmlite", "numpy", "scipy")


def package_versions() -> dict[str, str]:
    """Return the versions of this package and of the packages that decide the last bits of its
    results.
    """
    return {
        "undeadzone": undeadzone.__version__,
        **{name: _version_of_package(name) for name in PACKAGES},
    }


def _version_of_package(name: str) -> str:
    """Return the version of an installed package."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
