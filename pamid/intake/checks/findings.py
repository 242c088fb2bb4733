"""Findings of a check: records of `pamid.base.schemas.check_file`, and how they are made."""

from __future__ import annotations

from collections.abc import Sequence

from pamid.base.schemas.check_file import Finding, Issue
from pamid.base.units import NONE, split_column

Windows = Sequence[tuple[float, float]]


class CheckOutcome(Finding):
    """Outcome of a check: its subject, pass or fail, and the figure or sentence behind it."""

    @property
    def wrong(self) -> bool:
        return not self.ok and not self.advice


def outcome(check: str, ok: bool, detail: str, advice: bool = False) -> CheckOutcome:
    """Outcome of a check; advice: worth knowing, but nothing that makes the file wrong."""
    return CheckOutcome(check=check, ok=ok, advice=advice, detail=detail)


def passed(check: str, detail: str) -> CheckOutcome:
    """Outcome of a check that found nothing."""
    return outcome(check, True, detail)


def fault(check: str, detail: str) -> CheckOutcome:
    """Outcome that makes the file wrong."""
    return outcome(check, False, detail)


def note(check: str, detail: str) -> CheckOutcome:
    """Outcome that is worth knowing."""
    return outcome(check, False, detail, advice=True)


def named(subject: str, findings: Sequence[CheckOutcome]) -> list[CheckOutcome]:
    """Findings with their subject in front."""
    return [outcome(f.check, f.ok, f"{subject}: {f.detail}", f.advice) for f in findings]


class QualityIssue(Issue):
    """Finding about a recording.

    severity   "wrong": any fit on it is nonsense; "advice": worth knowing, or worth a correction
    message    the fault, without its places; `text` has everything
    windows_s  places: (from, to) on the recording's clock; empty for the whole recording
    """

    @property
    def text(self) -> str:
        """Fault, place ("at 3.2 to 3.4 s and 11 more places") and remedy."""
        where = ""
        if self.windows_s:
            (begin, end), more = self.windows_s[0], len(self.windows_s) - 1
            where = f", at {begin:.4g}{'' if end == begin else f' to {end:.4g}'} s"
            where += f" and {more} more {'place' if more == 1 else 'places'}" if more else ""
        return f"{self.message}{where}. {self.hint}".rstrip()


def issue(
    kind: str,
    columns: str | Sequence[str],
    message: str,
    hint: str = "",
    figures: dict[str, float] | None = None,
    windows: Windows = (),
    *,
    wrong: bool = False,
) -> QualityIssue:
    """Finding about a column or several.

    figures: the numbers behind it, with their units in the names. wrong: any fit is nonsense; else
    it is worth knowing, or worth a correction.
    """
    return QualityIssue(
        kind=kind,
        columns=(columns,) if isinstance(columns, str) else tuple(columns),
        severity="wrong" if wrong else "advice",
        message=message,
        hint=hint,
        windows_s=tuple(windows),
        figures=figures or {},
    )


def unit_after(column: str) -> str:
    """Unit of a column, to follow a number: " kPa", or "" without a unit."""
    symbol = split_column(column)[1]
    return "" if symbol == NONE else f" {symbol}"


def share_words(share: float) -> str:
    """ "for 4 % of the time"."""
    return f"for {f'{100.0 * share:.2g} %' if share >= 1e-3 else 'less than 0.1 %'} of the time"
