"""Plot that a notebook shows and a script saves."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from avrare.base.atomic_files import explain_file_errors, write_atomic
from avrare.base.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Plot:
    """A matplotlib figure that belongs to no window; ``figure`` may be changed before it is saved."""

    figure: Figure

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the plot; the ending of the name (png, svg, pdf) chooses the format.

        Raises:
            UsageError: The file cannot be written, or its ending names no format.
        """
        file, formats = Path(path), self.figure.canvas.get_supported_filetypes()
        ending = file.suffix[1:].lower() or "png"
        if ending not in formats:
            text = f"{path}: no plot can be written as {ending!r}"
            raise UsageError(text, "end its name with png, svg or pdf")
        with explain_file_errors(f"{path}: cannot write", "choose another file"):
            write_atomic(file, self._encode(ending))
        return file

    def _encode(self, ending: str) -> bytes:
        content = io.BytesIO()
        self.figure.savefig(content, dpi=110, format=ending)
        return content.getvalue()

    def _repr_png_(self) -> bytes:
        return self._encode("png")
