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
    """Signals within the limits of a model; without `limited` all are as drawn."""

    limited: SafeExcitation | None = None

    def samples(self, column: str, sent: Sent) -> NDArray[Any]:
        """Samples of a column."""
        return sent.samples if self.limited is None else self.limited.columns[column]

    def reach(self, column: str, centre: float, amplitude: float) -> tuple[float, float]:
        """Lowest and highest value of a column after the limits were applied."""
        if self.limited is not None:
            for item in self.limited.commands:
                if item.column == column:
                    centre, amplitude = centre + item.shift, item.factor * amplitude
        return centre - amplitude, centre + amplitude

    @property
    def sentences(self) -> list[str]:
        """Sentences about the limits, for people."""
        return [] if self.limited is None else self.limited.sentences()

    @property
    def entry(self) -> dict[str, Any]:
        """Entry about the limits in the excitation's JSON."""
        if self.limited is None:
            return {}
        return {
            "limits": {
                "checked": self.limited.limits,
                "commands": [
                    {
                        "column": item.column,
                        "factor": item.factor,
                        "shift": item.shift,
                        "why": item.why,
                    }
                    for item in self.limited.commands
                ],
                "reached": self.limited.reached,
            }
        }


def within(
    request: dict[str, Any], sent: Mapping[str, Sent], offsets: Mapping[str, float]
) -> LimitedSignals:
    """Signals within the limits of the rig, if it is a model that states limits."""
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
                raise  # a column named by hand needs no rig
    if speeds and limited is None:
        raise UsageError("--speed-limit needs a MuJoCo or URDF model, and excludes --no-limits.")
    return LimitedSignals(limited)
