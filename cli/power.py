"""`pamid power`: Predict which effects an experiment would show, before any measurement."""

from __future__ import annotations

from dataclasses import dataclass

from pamid.api.options.record import FilePath, option
from pamid.api.options.simulating import PowerArguments
from pamid.base.errors import quoted

from . import frame
from .figures import require_png, write_figure
from .hints import rig_words
from .terminal import progress_line

HELP_ORDER = 22
EXAMPLE = """
pamid power --rig one-dof --excitation excitation.csv --figure power.png
"""


@dataclass(frozen=True, kw_only=True)
class Arguments(PowerArguments):
    __doc__ = PowerArguments.__doc__

    figure: FilePath | None = option(None, "PNG to draw: effects by size.")
    overwrite: bool = option(False, "Replace the figure if it exists.")


@frame.command("power", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.planning import power

    require_png(arguments.figure, arguments.overwrite)
    with progress_line("power") as progress:
        result = power.of(frame.reporting(arguments, progress))
    text = result.summary()
    if arguments.figure is not None:
        text += f"\n\n{write_figure(arguments.figure, result.picture())}"
    excitation, rig = quoted(result.excitation), rig_words(str(arguments.rig or result.rig))
    follow = f"pamid simulate --excitation {excitation} {rig} --output rec.csv"
    return frame.Result(result.to_dict(), f"{text}\nNext: {follow}")
