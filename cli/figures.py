"""Figures of commands: the --figure option, checked before any work and written after it."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import UsageError, quoted
from pamid.base.files import PathLike, make_folder, require_new, write_atomically


def require_png(figure: PathLike | None, overwrite: bool) -> None:
    """Check the path of a figure before any work.

    Raises UsageError unless it ends in .png, and FileError if it exists and may not be replaced.
    """
    require_png_name(figure)
    require_new([Path(figure)] if figure else [], overwrite, "--figure")


def require_png_name(figure: PathLike | None) -> None:
    """Raise UsageError unless the path of a figure ends in .png."""
    if figure is not None and (path := Path(figure)).suffix.lower() != ".png":
        raise UsageError(
            f"--figure {figure}: the figure is written as PNG.",
            f"Write --figure {quoted(path.with_suffix('.png'))}.",
        )


def write_figure(figure: PathLike, png: bytes) -> str:
    """Write a figure and its folder, and return a line about it."""
    make_folder(Path(figure).parent)
    write_atomically(Path(figure), png)
    return f"Figure: {figure}"
