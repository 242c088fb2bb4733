"""`pamid force-law`: Train a muscle's force law on a measured map and compare analytic laws."""

from __future__ import annotations

from pamid.api.options.exporting import ForceLawArguments
from pamid.base.errors import quoted

from . import frame
from .terminal import staged_progress

HELP_ORDER = 70
EXAMPLE = """
pamid force-law data/example/muscle_map.csv --output law
pamid check law/rig.py
"""


@frame.command("force-law", ForceLawArguments, example=EXAMPLE)
def command(arguments: ForceLawArguments) -> frame.Result:
    from pamid.api.force_laws import force_law

    with staged_progress("force-law") as progress:
        law = force_law.of(frame.reporting(arguments, progress))
    rig = quoted(law.rig_file)
    follow = f"Next: pamid check {rig}   or   --rig {rig} in simulate, fit or diagnose, which run "
    return frame.Result(law.to_dict(), f"{law.summary()}\n{follow}that file.")
