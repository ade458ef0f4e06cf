"""Which MetaDrive this distribution is made for."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from avrare.errors import PluginError

CHECKED = "0.4.3"
"""Of ``metadrive-simulator``. ``engine`` replaces one of its private methods, so that no other will do."""
HINT = f"in an environment of its own: pip install metadrive-simulator=={CHECKED}"


def installed() -> str | None:
    """The installed version; MetaDrive itself is not imported."""
    try:
        return version("metadrive-simulator")
    except PackageNotFoundError:
        return None


def refuse_others() -> None:
    """Let no MetaDrive and the right one pass.

    Raises:
        PluginError: Another version is installed.
    """
    found = installed()
    if found not in (None, CHECKED):
        raise PluginError(f"metadrive-simulator {found} is installed, and {CHECKED} is needed", HINT)


def require() -> None:
    """Let only the right MetaDrive pass.

    Raises:
        PluginError: Another version is installed, or none.
    """
    refuse_others()
    if installed() is None:
        raise PluginError(f"metadrive-simulator {CHECKED} is not installed", HINT)
