"""A generator of random numbers without chance, for the sizes of the trial's faults."""

from typing import Any


class Middle:
    """Draws the middle of every range, and the last of every choice."""

    def uniform(self, low: float, high: float) -> float:
        return 0.5 * (low + high)

    def choice(self, values: tuple[float, ...]) -> float:
        return values[-1]


MIDDLE: Any = Middle()
