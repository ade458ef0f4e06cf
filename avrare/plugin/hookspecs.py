"""The hook that a plugin implements."""

from __future__ import annotations

import pluggy

from avrare.plugin.component import Component

GROUP = "avrare"
"""Entry-point group and pluggy project name."""

API_VERSION = 1

hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)


class HookSpecs:
    """Hooks that avrare calls."""

    @hookspec
    def avrare_components(self) -> list[Component]:  # type: ignore[empty-body]
        """The components of this plugin, as descriptions. Import nothing heavy here."""
