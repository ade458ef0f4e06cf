"""Supported version of MetaDrive."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from avrare.base.errors import PluginError

CHECKED = "0.4.3"
"""Version of ``metadrive-simulator``; exact, because ``engine`` replaces a private method."""
HINT = f"in a separate environment: pip install metadrive-simulator=={CHECKED}"


def find_version() -> str | None:
    """Return the installed version without importing MetaDrive."""
    try:
        return version("metadrive-simulator")
    except PackageNotFoundError:
        return None


def check_supported(optional: bool = False) -> None:
    """Check the installed version.

    Raises:
        PluginError: Another version is installed, or none and it is not ``optional``.
    """
    present = find_version()
    if present is None and not optional:
        raise PluginError(f"metadrive-simulator {CHECKED} is not installed", HINT)
    if present not in (None, CHECKED):
        raise PluginError(f"metadrive-simulator {present} is installed, but {CHECKED} is required", HINT)
