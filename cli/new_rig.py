"""`pamid new-rig`: Write a first rig file from a recording's columns."""

from __future__ import annotations

from pamid.api.options.preparing import NewRigArguments
from pamid.base.errors import quoted

from . import frame

HELP_ORDER = 45
EXAMPLE = """
pamid new-rig rec.csv --output my_rig.py
pamid new-rig rec.csv --like two-masses --column position_1_mm=x_mm --output my_rig.py
"""


@frame.command("new-rig", NewRigArguments, example=EXAMPLE)
def command(arguments: NewRigArguments) -> frame.Result:
    from pamid.api.new_rigs import new_rig

    written = new_rig.of(arguments)
    rig, recording = quoted(written.path), quoted(str(arguments.recording))
    follow = (
        f"Next: pamid check {rig}   or   pamid check {recording} --rig {rig}   (both run that file)"
    )
    return frame.Result(written.to_dict(), f"{written.summary()}\n{follow}")
