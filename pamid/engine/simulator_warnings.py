"""Warnings of a simulator, counted over chosen runs of this process.

Fits step a simulator millions of times, in several processes and with values that nobody keeps.
Warnings count where a model is run once more as it is reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class SimulatorWarnings:
    """simulator: its name; steps: that it has made; counts: steps with a warning, by its words;
    cures: a sentence for some of these words."""

    simulator: str = ""
    steps: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    cures: dict[str, str] = field(default_factory=dict)

    def sentences(self, where: str) -> tuple[str, ...]:
        """A text on the warnings, () without any. where: a description of the runs."""
        warned = {words: n for words, n in self.counts.items() if n}
        if not warned:
            return ()
        listed = ", ".join(f"{words} in {n}" for words, n in warned.items())
        cures = dict.fromkeys(self.cures[words] for words in warned if words in self.cures)
        head = f"{self.simulator} warned {where} ({self.steps} steps): {listed}."
        return (" ".join([head, *cures]),)


_COUNTING: list[SimulatorWarnings] = []


@contextmanager
def counted_warnings() -> Iterator[SimulatorWarnings]:
    """Count the warnings of simulators in this block."""
    counted = SimulatorWarnings()
    _COUNTING.append(counted)
    try:
        yield counted
    finally:
        # by identity: two of them may hold the same numbers
        _COUNTING[:] = [other for other in _COUNTING if other is not counted]


def add_warnings(
    simulator: str, steps: int, warned: Mapping[str, int], cures: Mapping[str, str]
) -> None:
    """Add steps and, by words, how often a simulator has warned in them, with cures."""
    for counted in _COUNTING:
        counted.simulator = simulator
        counted.steps += steps
        counted.cures |= cures
        for words, number in warned.items():
            # A simulator may warn several times in a step; the report counts steps.
            counted.counts[words] = counted.counts.get(words, 0) + min(number, steps)
