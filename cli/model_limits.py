"""Excitation of a MuJoCo or URDF model within the model's own limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .options import parse_known

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pamid.excitation.waveforms import Sent
    from pamid.simulators.safe_excitation import SafeExcitation


@dataclass(frozen=True, eq=False)
class LimitedSignals:
    """The signals within their limits; None: nothing was looked at, and all are as they were
    drawn."""

    found: SafeExcitation | None = None

    def samples(self, column: str, sent: Sent) -> NDArray[Any]:
        """Samples of a column."""
        return sent.samples if self.found is None else self.found.columns[column]

    def reach(self, column: str, centre: float, amplitude: float) -> tuple[float, float]:
        """Between which values it was to be, and is now."""
        if self.found is not None:
            for item in self.found.commands:
                if item.column == column:
                    centre, amplitude = centre + item.shift, item.factor * amplitude
        return centre - amplitude, centre + amplitude

    @property
    def said(self) -> list[str]:
        return [] if self.found is None else self.found.sentences()

    @property
    def noted(self) -> dict[str, Any]:
        """Entry of the excitation's note."""
        if self.found is None:
            return {}
        return {
            "limits": {
                "checked": self.found.limits,
                "commands": [
                    {
                        "column": item.column,
                        "factor": item.factor,
                        "shift": item.shift,
                        "why": item.why,
                    }
                    for item in self.found.commands
                ],
                "reached": self.found.reached,
            }
        }


def within(
    request: dict[str, Any], sent: Mapping[str, Sent], offsets: Mapping[str, float]
) -> LimitedSignals:
    """The signals within what the rig allows, where it is a model that says so."""
    from pamid.api.exciting import within_limits
    from pamid.base.errors import FileError, UsageError

    speeds = parse_known(request["speed_limit"], "Write elbow=2.")
    limited = None
    if request["limits"]:
        columns = {column: item.samples for column, item in sent.items()}
        try:
            limited = within_limits(
                request["rig"], columns, request["period"], centres=offsets, speed_limits=speeds
            )
        except FileError:
            if request["column"] is None:
                raise  # a rig is only noted where a column is named by hand
    if speeds and limited is None:
        raise UsageError(
            "--speed-limit belongs to a MuJoCo or URDF model that is kept within its limits."
        )
    return LimitedSignals(limited)
