"""`--fail-if`: conditions on the figures of a result, for scripts and CI."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click

from pamid.api.options.record import option
from pamid.base.errors import nearest

from .terminal import aside

#: exit code of a command whose result meets a condition of --fail-if
MET = 7
_COMPARISONS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
_CONDITION = re.compile(r"\s*([A-Za-z_]\w*)\s*(>=|<=|>|<)\s*(\S+)\s*")


@dataclass(frozen=True)
class Condition:
    """A figure by name, compared with a number."""

    name: str
    comparison: str
    limit: float

    def holds(self, figures: Mapping[str, float | None]) -> bool:
        """Whether the condition is met. A figure of an unstable model (None) meets every one."""
        value = figures[self.name]
        if value is None:
            return True
        return bool(_COMPARISONS[self.comparison](value, self.limit))


class _ConditionType(click.ParamType):
    name = "condition"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Condition:
        parts = _CONDITION.fullmatch(str(value))
        limit = _finite(parts[3]) if parts else None
        if parts is None or limit is None:
            self.fail(f"{value!r} is not a condition such as 'remainder > 0.3'.", param, ctx)
        return Condition(parts[1], parts[2], limit)


def _finite(text: str) -> float | None:
    """Number that a text states; None for any other text, infinity and nan included."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def fail_if_option(figures: str) -> Any:
    """The `--fail-if` option; figures: names of the figures, for the help."""
    return option(
        (),
        f"Exit with code {MET} if this condition is met: {figures}. The result is printed in any "
        "case.",
        "--fail-if",
        metavar="CONDITION",
        click={"type": _ConditionType()},
    )


def exit_code_of(
    conditions: Sequence[Condition], figures: Mapping[str, float | None], otherwise: int = 0
) -> int:
    """Exit code 7 if a condition is met, 2 if one names an unknown figure, else `otherwise`.

    stderr names these conditions: the result is printed nevertheless.
    """
    unknown = [condition.name for condition in conditions if condition.name not in figures]
    for name in unknown:
        aside(
            f"pamid: there is no result {name!r} (--fail-if). {nearest(name, figures)}"
            f" Results: {', '.join(figures)}."
        )
    if unknown:
        return click.UsageError.exit_code
    met = [condition for condition in conditions if condition.holds(figures)]
    for condition in met:
        value, limit = figures[condition.name], f"{condition.comparison} {condition.limit:g}"
        shown = "of an unstable model" if value is None else f"{value:.4g}, which is {limit}"
        aside(f"pamid: {condition.name} is {shown} (--fail-if)")
    return MET if met else otherwise
