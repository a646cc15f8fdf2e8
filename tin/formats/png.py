"""PNG: a picture of the TIN and of its errors, see ``tin.plot``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tin.formats.common import title

if TYPE_CHECKING:
    from tin.tin import Tin


def write(tin: Tin, path: Path) -> None:
    """Draw ``tin.plot.figure`` of ``tin``."""
    from tin.plot import figure

    # Without matplotlib's name and version the same TIN gives the same bytes.
    figure(tin).savefig(path, format="png", metadata={"Software": None, "Title": title(tin)})
