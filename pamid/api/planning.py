"""`pamid.power`: what an experiment would show of every effect, before anything is measured."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pamid.api.given import effects_given, recording_given
from pamid.api.options.record import verb
from pamid.api.options.simulating import PowerArguments
from pamid.api.simulating import recorded
from pamid.api.workers import worker_pool
from pamid.base.card import card, html_table
from pamid.base.progress import progress_steps
from pamid.base.schemas.command_files import PowerFile, ShownEffect
from pamid.diagnosis.planning.detectable_effects import SEEN, SIZES, USUAL, experiment_power
from pamid.model.registry import effects_with, resolved_rig, rig_named, rig_of
from pamid.recording.recording import SIGNIFICANT_DIGITS
from pamid.simulation.data_split import Span, split_recordings
from pamid.simulation.virtual_rig import simulate_virtual_rig

if TYPE_CHECKING:
    from pamid.recording.plot import NotebookFigure
    from pamid.report.style import Drawing

HEAD: tuple[str, ...] = ("effect", "shows from", "usual", "alone by", "taken for")


class PowerResult(PowerFile):
    """Detectability of effects in an experiment.

    effects: plainest first; showing: labels of the effects that are detectable at their usual
    size; hidden: all others.
    """

    @property
    def showing(self) -> tuple[str, ...]:
        return tuple(e.effect for e in self.effects if e.visible and e.visible[USUAL] >= SEEN)

    @property
    def hidden(self) -> tuple[str, ...]:
        return tuple(e.effect for e in self.effects if e.effect not in self.showing)

    @property
    def title(self) -> str:
        """The finding in a sentence."""
        confused = sum(bool(e.confused) for e in self.effects if e.effect in self.showing)
        return (
            f"This experiment of {self.seconds:.3g} s shows {len(self.showing)} of "
            f"{len(self.effects)} effects at their usual size; {confused} of these cannot be "
            "separated from another family"
        )

    to_dict = PowerFile.as_json

    def summary(self) -> str:
        """The finding and a table, as lines of text."""
        rows = [HEAD, *(self._row(e) for e in self.effects)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(HEAD))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return "\n".join([f"{self.title}.", "", *lines])

    def _row(self, e: ShownEffect) -> tuple[str, ...]:
        if e.failed or e.amount is None:
            return e.effect, "-", "-", "-", e.failed
        amount = e.amount
        unit = f" {amount.unit}" if amount.unit not in ("", "1", "-") else ""
        return (
            e.effect,
            "does not show" if amount.least is None else f"{amount.least:.2g}{unit}",
            f"{amount.usual:.2g}{unit}",
            ", ".join(c for c, v in e.by_channel.items() if v >= self.seen) or "-",
            ", ".join(e.confused[:3]) + (" ..." if len(e.confused) > 3 else ""),
        )

    def plot(self) -> NotebookFigure:
        """Detectability of the effects over their size."""
        from pamid.report.style import figure_of

        return figure_of(self._drawing())

    def picture(self) -> bytes:
        """The same as a PNG."""
        from pamid.report.style import render

        return render(self._drawing()).png

    def _drawing(self) -> Drawing:
        from pamid.report.power_figure import power_drawing

        return power_drawing(self, self.title)

    def _repr_html_(self) -> str:
        return card(self.title, html_table((HEAD, [self._row(e) for e in self.effects])))


@verb(PowerArguments)
def power(arguments: PowerArguments) -> PowerResult:
    """Detectability of effects in an experiment: smallest size, sensor, and confusions.

    The rig of the data sheet is linearised and compared with noise, parameters and tolerances. A
    real machine has further deviations, which an effect must exceed as well.

    Raises
    ------
    PamidError
        Files, data or arguments are wrong.
    """
    a = arguments
    source = recording_given(a.excitation, "excitation")
    rig = resolved_rig(a.rig) or rig_of([source])
    simulated = simulate_virtual_rig(rig, source, (), dict(a.known or {}), {}, a.noise, a.seed)
    recording = recorded(source, simulated, SIGNIFICANT_DIGITS)
    split = split_recordings(rig_named(rig), [recording], [])
    # nothing is chosen here: all of it counts as fitted
    split = replace(split, fit=(Span(split.recordings[0], 0, len(recording)),))
    catalogue, _ = effects_with(effects_given(a.effects))
    with progress_steps(a.progress, "power") as (show, _), worker_pool(a.jobs) as pool:
        shown = experiment_power(split, catalogue, pool=pool, progress=show)
    return PowerResult(
        rig=split.rig.name,
        excitation=str(source.path),
        seconds=len(recording) * recording.sampling_period_s,
        noise=a.noise,
        seed=a.seed,
        channels=split.channels,
        sizes=SIZES,
        seen=SEEN,
        effects=shown,
    )
