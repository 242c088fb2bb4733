"""How the logs of a robot call the columns of a rig: by joint or motor, and what of it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class LogName:
    """names       of what the column belongs to: sensor or motor first, then its joint
    quantity    position, velocity or effort, "" where it can be any
    sent        a command
    places      in the vectors of a simulator: its name -> from 0
    per_effort  what is sent (column's unit) per N m or N at the joint, where in the model a
                measured effort is nothing else; None: it does not
    """

    names: tuple[str, ...]
    quantity: str
    sent: bool = False
    places: dict[str, int] = field(default_factory=dict)
    per_effort: float | None = None
