"""`pamid.check`: what is wrong with a recording, a rig or an effect, before any fitting."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pamid.api.given import recording_given
from pamid.api.options.preparing import CheckArguments
from pamid.api.options.record import verb
from pamid.base.card import card, html_table
from pamid.base.errors import UsageError
from pamid.base.schemas.rig_map import RigMap
from pamid.intake.checks.findings import CheckOutcome
from pamid.intake.checks.inspection import Inspection, checked_ports, inspect
from pamid.intake.checks.inspection_words import inspection_text
from pamid.model.registry import resolved_rig
from pamid.model.rig import Rig
from pamid.recording.recording import Recording

if TYPE_CHECKING:
    from pamid.recording.plot import NotebookFigure
    from pamid.report.style import Drawing


@dataclass(frozen=True)
class CheckResult:
    """Result of a check.

    kind: "recording", "rig", "effect" or "python"; ok: there are no problems (notes are
    allowed); findings: (check, ok, detail, advice), with advice True for a recommendation;
    recording: the recording, None if it was unreadable or the subject is a rig or an effect.
    """

    subject: str
    kind: str
    ok: bool
    findings: tuple[CheckOutcome, ...]
    recording: Recording | None
    _inspection: Inspection
    _rig: Path | type[Rig] | None = None

    @property
    def problems(self) -> tuple[CheckOutcome, ...]:
        """Findings that are errors."""
        return tuple(f for f in self.findings if f.wrong)

    @property
    def notes(self) -> tuple[CheckOutcome, ...]:
        """Findings worth knowing that are no errors."""
        return tuple(f for f in self.findings if not f.ok and f.advice)

    def to_dict(self) -> dict[str, Any]:
        """JSON object of the command."""
        return dict(self._inspection.summary)

    def summary(self, *, everything: bool = True) -> str:
        """Problems first, then notes and what is as it should be, as lines of text; a rig on a
        single screen, unless everything is wanted."""
        return inspection_text(self._inspection.summary, everything=everything)

    @property
    def drawable(self) -> bool:
        """Is there a picture of it?"""
        return self.recording is not None or self._ports() is not None

    def plot(self) -> NotebookFigure:
        """Every channel of a recording with the places of each finding; a rig as a block diagram of
        its ports. UsageError for anything else."""
        from pamid.report.style import figure_of

        return figure_of(self._drawing())

    def plot_png(self) -> bytes:
        """The same as a small PNG file."""
        from pamid.report.style import png_of

        return png_of(self._drawing())

    def _drawing(self) -> Drawing:
        from pamid.report.quality_figure import quality_drawing
        from pamid.report.rig_figure import bare_rig_drawing

        if (ports := self._ports()) is not None:
            return bare_rig_drawing(ports)
        if self.recording is None:
            what = "could not be read" if self.kind == "recording" else f"is a {self.kind} file"
            raise UsageError(f"{self.subject} {what}: only recordings and sound rigs are drawn.")
        issues = self._inspection.issues
        drawn = {issue.text for issue in issues}
        others = [f.detail for f in self.problems if f.detail not in drawn]
        channels = self._inspection.summary["quality"]["channels"]
        return quality_drawing(self.recording, issues, channels, others)

    def _ports(self) -> RigMap | None:
        """The ports of a checked rig; None of anything else, or where it does not build."""
        return None if self.kind != "rig" or self._rig is None else checked_ports(self._rig)

    def __repr__(self) -> str:
        return f"<CheckResult {self._headline()}>"

    def _repr_html_(self) -> str:
        rows = [("wrong", f.check, f.detail) for f in self.problems]
        rows += [("note", f.check, f.detail) for f in self.notes]
        return card(self._headline(), html_table((("", "check", "finding"), rows)))

    def _headline(self) -> str:
        count = len(self.problems)
        wrong = "nothing is wrong" if self.ok else f"{count} problem{'' if count == 1 else 's'}"
        return f"{self.subject} ({self.kind}): {wrong}, {len(self.notes)} notes"


@verb(CheckArguments)
def check(arguments: CheckArguments) -> CheckResult:
    """Check a recording, a rig or an effect, before anything is fitted.

    Recordings are checked for clipped, frozen, lost, spiked, coarse and hardly excited channels;
    with a rig also for exchanged, inverted, wrongly scaled and delayed columns. Rigs must build,
    use every port, stay finite over the bounds and have exact sensitivities. Effects need complete
    parameters and an exact null.

    Returns
    -------
    CheckResult
        Findings; errors are listed and not raised.

    Raises
    ------
    FileError
        The file does not exist, or is of another kind.
    """
    subject = arguments.subject
    looked_at: Any = subject
    if isinstance(subject, Rig):
        looked_at = type(subject)
    elif isinstance(subject, str | os.PathLike):
        looked_at = Path(subject)
    elif not isinstance(subject, type):
        looked_at = recording_given(subject)
    inspection = inspect(looked_at, resolved_rig(arguments.rig))
    content = inspection.summary
    return CheckResult(
        content["file"],
        content["kind"],
        content["ok"],
        tuple(CheckOutcome(**f) for f in content["findings"]),
        inspection.recording,
        inspection,
        looked_at
        if isinstance(looked_at, type) and issubclass(looked_at, Rig)
        else looked_at
        if isinstance(looked_at, Path)
        else None,
    )
