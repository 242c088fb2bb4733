"""`pamid export`: Write an identified model as FMU, C, ONNX or MATLAB function."""

from __future__ import annotations

from pamid.api.options.exporting import ExportArguments

from . import frame
from .terminal import staged_progress

HELP_ORDER = 120
EXAMPLE = """
pamid export run --to fmu --output joint.fmu
"""


@frame.command("export", ExportArguments, example=EXAMPLE)
def command(arguments: ExportArguments) -> frame.Result:
    from pamid.api.exporting import export

    with staged_progress("export") as progress:
        result = export.of(frame.reporting(arguments, progress))
    return frame.Result(result.to_dict(), result.summary())
