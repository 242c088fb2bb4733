"""Words for the "Next:" lines: free output folders, rigs, and those that accept an excitation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pamid.base.errors import FileError, quoted

from .frame import PACKAGES

if TYPE_CHECKING:
    from numpy.typing import NDArray

MOST_TRIED = 1000


def unused(name: str, read: Iterable[Path] = ()) -> str:
    """`name`, with a number appended if the path exists, because commands refuse existing outputs.

    read: input files of the same command line.
    """
    first, occupied = Path(name), {path.resolve() for path in read}
    every = (first, *(first.with_stem(f"{first.stem}-{k}") for k in range(2, MOST_TRIED)))
    return str(next((p for p in every if not p.exists() and p.resolve() not in occupied), first))


def rig_words(rig: str | Path) -> str:
    """--rig and the --package options of this command, for a command line to copy."""
    ctx = click.get_current_context(silent=True)
    pairs = ctx.meta.get(PACKAGES, ()) if ctx else ()
    return " ".join([f"--rig {quoted(rig)}", *(f"--package {quoted(pair)}" for pair in pairs)])


def why_not_driven(rig_name: str, path: Path, columns: Mapping[str, NDArray[Any]]) -> str:
    """Reason why `pamid simulate` cannot send these columns to a rig, or "".

    The rig may be unknown, because columns named by hand need none.
    """
    import numpy as np

    from pamid.model.registry import rig_named
    from pamid.recording.recording import Recording
    from pamid.simulation.virtual_rig import in_its_loop

    sent = Recording(path.stem, path, "", np.zeros(0), dict(columns), 1.0)
    try:
        rig = rig_named(rig_name)
        closed = in_its_loop(rig, sent)
    except FileError as error:
        return error.message.rstrip(".")
    needed = [name for name in rig.inputs if name not in rig.optional and not sent.has(name)]
    if needed and not closed:
        return f"rig {rig.name!r} needs {' and '.join(needed)}"
    known = (*rig.inputs, *(q.reference for q in rig.loops))
    return (
        "" if any(sent.has(name) for name in known) else f"rig {rig.name!r} has none of the columns"
    )
