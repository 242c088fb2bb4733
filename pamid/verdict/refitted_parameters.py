"""The parameters that the answer's model moved off the data sheet, for terminal, page and card.

Only those are shown that moved: the 95 % interval excludes the data-sheet value, and the shift is
more than a rounding of its tolerance, or of the value where the tolerance is wide. The others are
counted. Those that the recordings say nothing about are named: their values are the priors'.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pamid.base.units import split_column
from pamid.schemas.estimates import Estimate

# of a prior standard deviation, and of the value: precise data resolve smaller shifts, which matter
# to nobody
LEAST_SHIFT, LEAST_PART = 0.1, 0.05
MOST_NAMED = 4  # parameters that are not determined; more are counted


@dataclass(frozen=True)
class RefittedParameters:
    """shown: those that moved, by name, the largest shift first; total: parameters of the model;
    undetermined: of the others, those that the recordings do not determine, by name."""

    shown: Mapping[str, Estimate]
    total: int
    undetermined: tuple[str, ...] = ()

    def remark(self) -> str:
        """Sentence about the omitted parameters; "" if all are shown."""
        rest = self.total - len(self.shown)
        if not rest:
            return ""
        noun = "other" if self.shown else "parameter"
        text = f"{rest} {noun}{'s' if rest > 1 else ''} not moved materially"
        if not self.undetermined:
            return text
        names = [split_column(name)[0] for name in self.undetermined[:MOST_NAMED]]
        more = len(self.undetermined) - len(names)
        names += [f"{more} more"] if more else []
        return f"{text}; not determined by these recordings: {', '.join(names)}"

    def texts(self) -> list[str]:
        """ "mass 0.5 -> 0.62 kg (0.61 .. 0.63)", and the number of those left out."""
        rows = [_shift_text(name, entry) for name, entry in self.shown.items()]
        return [text for text in (*rows, self.remark()) if text]


def refitted_parameters(parameters: Mapping[str, Estimate]) -> RefittedParameters:
    """The parameters that moved materially, and the number of all."""
    moved = [item for item in parameters.items() if _moved(item[1])]
    moved.sort(key=lambda item: -abs(item[1].strain or 0.0))
    shown = dict(moved)
    open_ones = [
        k for k, parameter in parameters.items() if parameter.word == "silent" and k not in shown
    ]
    return RefittedParameters(shown, len(parameters), tuple(open_ones))


def _moved(estimate: Estimate) -> bool:
    if estimate.prior is None or estimate.low is None or estimate.high is None:
        return estimate.prior is None
    if estimate.low <= estimate.prior <= estimate.high:
        return False
    strained = estimate.strain is None or abs(estimate.strain) >= LEAST_SHIFT
    return strained or abs(estimate.value - estimate.prior) >= LEAST_PART * abs(estimate.prior)


def _shift_text(name: str, estimate: Estimate) -> str:
    stem, unit = split_column(name)
    prior = "" if estimate.prior is None else f"{estimate.prior:.4g} -> "
    low_high = (
        ""
        if estimate.low is None or estimate.high is None
        else f" ({estimate.low:.4g} .. {estimate.high:.4g})"
    )
    unit_text = "" if unit in ("", "-", "1") else f" {unit}"
    text = f"{stem} {prior}{estimate.value:.4g}{unit_text}{low_high}"
    return text + bound_text(estimate)


def bound_text(estimate: Estimate) -> str:
    """ ", at its lower bound"; "" between the bounds."""
    return (
        f", at its {'lower' if estimate.at_bound == 'low' else 'upper'} bound"
        if estimate.at_bound
        else ""
    )
