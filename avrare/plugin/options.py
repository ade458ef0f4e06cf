"""Base class of the options of components."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict


class Options(BaseModel):
    """Options of a component, or a block within them: frozen, without unknown keys or infinite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def used_files(self) -> Mapping[str, Path]:
        """Return files that no mark names, such as those within arguments, by option. Default: none."""
        return {}

    def used_models(self) -> Mapping[str, Path]:
        """Return model files of the distribution that these options name, by option. Default: none."""
        return {}

    def used_versions(self) -> Mapping[str, str]:
        """Return versions of distributions whose components these options choose. Default: none."""
        return {}
