"""Plot that a notebook shows and a script saves."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import UsageError


@dataclass(frozen=True)
class Plot:
    """A matplotlib figure that belongs to no window; ``figure`` may be changed before it is saved."""

    figure: Any

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the plot; the ending of the name (png, svg, pdf) chooses the format."""
        ending, formats = Path(path).suffix[1:].lower(), self.figure.canvas.get_supported_filetypes()
        if ending and ending not in formats:
            raise UsageError(
                f"{path}: no plot can be written as {ending!r}", "end its name with png, svg or pdf"
            )
        with explain_file_errors(f"{path}: cannot write", "choose another file"):
            self.figure.savefig(path, dpi=130)
        return Path(path)

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        self.figure.savefig(content, format="png", dpi=110)
        return content.getvalue()
