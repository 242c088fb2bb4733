"""Results of runs as typed objects. Every result is read from its run folder, so that a result of
today and the same result opened years later are equal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pamid.api.given import RecordingLike
from pamid.api.simulating import simulate
from pamid.api.workers import OpenedRun, RunHome
from pamid.base.card import Cells, card, html_table, interval, number, paragraph, text_table
from pamid.base.errors import FileError, nearest
from pamid.base.files import PathLike
from pamid.base.result_file import read_result
from pamid.base.run_files import read_diagnosis
from pamid.base.run_folder import DIAGNOSIS_FILE, FIT_FILE
from pamid.base.schemas.diagnosis_file import (
    Candidate,
    GapShare,
    NextExperiment,
    Regime,
    Remainder,
    Unknown,
)
from pamid.base.schemas.estimates import Estimate
from pamid.base.schemas.fit_file import FitFile, RecordingUsed
from pamid.base.units import split_column
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.recording.recording import Recording
from pamid.report.answers import answers_of
from pamid.report.channel_errors import ChannelErrors, errors_of
from pamid.report.load import load_run

if TYPE_CHECKING:
    from pamid.recording.plot import NotebookFigure
    from pamid.report.writing import Report

# attributes that a result has from its files as they are
_OF_FIT = ("rig", "effects", "recordings", "channels", "converged", "why")
_OF_CAUSE = ("effect", "family", "port", "share", "probability", "removes")
_OF_DIAGNOSIS = (
    *("verdict", "sentence", "remark", "remainder", "ranking", "tied"),
    *("unknown", "next_experiment"),
)


class ParameterEstimate(Estimate):
    """A fitted parameter, in `unit` ("-": none).

    low, high: its 95 % interval, None where it was not free; prior: the data sheet's value, None
    where there is none; word: "settled", "weak" or "silent", by how much the recordings say of it;
    strain: distance from the prior in prior standard deviations; at_bound: "low" or "high" where it
    ended there; source: where the prior comes from.
    """

    name: str

    def __repr__(self) -> str:
        unit = "" if self.unit in ("", "-") else f" {self.unit}"
        word = f", {self.word}" if self.word else ""
        return f"<{self.name} = {number(self.value)}{unit} ({interval(self.low, self.high)}){word}>"


class ParameterTable(dict[str, ParameterEstimate]):
    """Fitted parameters by name, in the order of the rig."""

    def __missing__(self, name: str) -> ParameterEstimate:
        hint = nearest(name, self) or f"There are {', '.join(self)}."
        raise KeyError(f"{name!r}. {hint}")

    def __repr__(self) -> str:
        return text_table(self.rows()) if self else "no parameters"

    def _repr_html_(self) -> str:
        return card(f"{len(self)} parameters", html_table(self.rows()))

    def rows(self) -> Cells:
        """Header and rows for a table."""
        cells = [
            (
                p.name,
                number(p.value),
                interval(p.low, p.high),
                number(p.prior),
                "" if p.unit == "-" else p.unit or "",
                p.word + (f", at its {p.at_bound} bound" if p.at_bound else ""),
            )
            for p in self.values()
        ]
        return ("parameter", "value", "95 %", "data sheet", "unit", "known"), cells


@dataclass(frozen=True)
class IdentifiedCause:
    """An effect that the verdict names.

    effect: name, with @port where the rig has several of its kind; parameters: in the model that
    has all causes; share: Shapley share of the shrinkage among the causes, 0 to 1; probability:
    that it is really there, 0 to 1; removes: share of the gap, next to the other causes, with its
    95 % interval.
    """

    effect: str
    family: str
    port: str
    parameters: ParameterTable
    share: float | None
    probability: float | None
    removes: GapShare | None = None

    def __repr__(self) -> str:
        values = ", ".join(
            f"{p.name} {number(p.value)} ({interval(p.low, p.high)})"
            for p in self.parameters.values()
        )
        return f"<{self.effect} ({self.family}): {values}>"


@dataclass(frozen=True, kw_only=True)
class FitResult(OpenedRun):
    """A fitted model and its held-out errors.

    folder: of the run; rig: its name; effects: what was fitted with it; converged, why: of the
    search; recordings, channels: what it was fitted to; parameters: with 95 % intervals;
    combinations: identifiable combinations of parameters that are not identifiable separately;
    failed_jobs: (job, why); code: rig and effects given as files or Python objects, which
    `simulate` needs.
    """

    rig: str
    effects: tuple[str, ...]
    recordings: tuple[RecordingUsed, ...]
    channels: tuple[str, ...]
    converged: bool
    why: str
    parameters: ParameterTable
    combinations: ParameterTable
    failed_jobs: tuple[tuple[str, str], ...]

    @cached_property
    def errors(self) -> dict[str, ChannelErrors]:
        """Mean absolute errors on what was held out, by channel, in the channel's unit."""
        return {row.channel: row for row in errors_of(self.data)}

    def simulate(
        self,
        excitation: RecordingLike,
        *,
        which: str = "best",
        parameters: Mapping[str, float] | None = None,
        known: Mapping[str, float] | None = None,
        noise: float = 0.0,
        seed: int = 0,
    ) -> Recording:
        """Simulate the sensors of the run's model on an excitation, by its integration steps.

        excitation: columns that are sent (references run the model in its control loop); which:
        "cause", "network" (with the model that it was trained on), "refitted", or "best": causes
        and network where both go together, else the first of these there is; parameters, known:
        values by name in its unit that replace fitted ones, the latter stated in the recording;
        noise: factor on the rig's sensor noise. FileError where the run was made with a rig or
        effect file, or in Python, and it was opened without it; DataError where the excitation has
        another period, or the model becomes unstable.
        """
        return simulate(
            excitation,
            model=self,
            which=which,
            known=known,
            parameters=parameters,
            noise=noise,
            seed=seed,
        )

    def plot_errors(self) -> NotebookFigure:
        """Held-out mean absolute errors of every model, channel by channel."""
        return self._figure("held-out errors")

    def report(self, output: PathLike, *, pdf: PathLike | None = None) -> Report:
        """Write the page of this run to `output`, on request as a PDF as well."""
        from pamid.report.writing import write_report

        return write_report(self.folder, Path(output), None if pdf is None else Path(pdf))

    def __repr__(self) -> str:
        state = "" if self.converged else f", not converged: {self.why}"
        return f"<FitResult {self._model()}{state}>\n{text_table(self._error_rows())}"

    def _repr_html_(self) -> str:
        state = "" if self.converged else f"Not converged: {self.why}."
        return card(
            f"Fit of {self._model()}",
            paragraph(state),
            self._errors_html(),
            html_table(self.parameters.rows()),
        )

    def _model(self) -> str:
        return f"{self.rig} with {', '.join(self.effects)}" if self.effects else self.rig

    def _errors_html(self) -> str:
        return paragraph("Held-out mean absolute error") + html_table(self._error_rows())

    def _error_rows(self) -> Cells:
        models = ("data_sheet", "refitted", "with_network", "with_cause", "noise_floor")
        shown = [m for m in models if any(getattr(e, m) is not None for e in self.errors.values())]
        rows = [
            (
                split_column(name)[0],
                *(number(getattr(e, m)) for m in shown),
                split_column(name)[1],
            )
            for name, e in self.errors.items()
        ]
        return ("channel", *(m.replace("_", " ") for m in shown), "unit"), rows


@dataclass(frozen=True, kw_only=True, repr=False)
class DiagnosisResult(FitResult):
    """Where a model departs from its recordings, which effect causes it, how far the gap shrinks;
    in addition all that a fit holds, of the refitted model (`refitted`: its parameters) and of the
    model with its causes (`parameters`).

    verdict: "explained", "partly-explained", "ambiguous", "unknown-effect", "no-structural-gap" or
    "cannot-tell"; sentence: the same in words; remark: why the cause is undetermined, where that is
    so;
    ports: share of the gap that enters at each, 0 to 1, largest first; causes: strongest first;
    remainder: what remains of the gap; ranking: every candidate that was refitted; tied: effects
    that these recordings cannot separate from the first, an effect per family, itself among them;
    regimes: where in its range the gap shows; unknown: the term that no effect explains;
    next_experiment: what to measure next.
    """

    result_file: ClassVar[str] = DIAGNOSIS_FILE

    verdict: str = ""
    sentence: str = ""
    remark: str = ""
    ports: tuple[tuple[str, float], ...] = ()
    causes: tuple[IdentifiedCause, ...] = ()
    remainder: Remainder | None = None
    ranking: tuple[Candidate, ...] = ()
    regimes: tuple[Regime, ...] = ()
    tied: tuple[str, ...] = ()
    refitted: ParameterTable = field(default_factory=ParameterTable)
    unknown: Unknown | None = None
    next_experiment: NextExperiment | None = None

    def plot_rig(self) -> NotebookFigure:
        """The rig as a block diagram, tinted by the share of the gap; DataError for a run of an
        earlier version, which does not hold its rig's ports."""
        return self._figure("ports of its rig")

    def rig_png(self) -> bytes:
        """The same as a PNG file."""
        from pamid.api.plots import png

        return png(self.data, "ports of its rig")

    def overview_png(self) -> bytes:
        """The rig's diagram with the added-variable plots below it, as a PNG file."""
        from pamid.api.plots import overview_png

        return overview_png(self.data)

    def plot_added_variable(self, effect: str | None = None) -> NotebookFigure:
        """Added-variable plots of the three leading candidates, or of `effect`.

        Residual of the refitted model over the effect's contribution, other parameters projected
        out. DataError for a run without such plots, UsageError for an effect that was not refitted.
        """
        from pamid.api.plots import added_variable_figure

        return added_variable_figure(self.data, effect)

    def plot_ports(self) -> NotebookFigure:
        """The share of the gap that enters at every port; DataError where there is no gap."""
        return self._figure("shares of ports")

    def plot_ranking(self) -> NotebookFigure:
        """The share of the held-out error that every candidate removes."""
        return self._figure("candidates that were refitted")

    def __repr__(self) -> str:
        causes = "".join(f"\n  {c!r}" for c in self.causes)
        return f"<DiagnosisResult {self.verdict}: {self.remark or self.sentence}>{causes}"

    def _repr_html_(self) -> str:
        # with matplotlib, which no diagnosis needs
        from pamid.report.added_variable_figure import card_svg
        from pamid.report.rig_figure import rig_svg

        if self.remark:
            return card(self.verdict, paragraph(self.remark), self._errors_html())
        answers = answers_of(self.data, tuple(self.errors.values()))
        texts = [
            paragraph(text)
            for answer in answers
            for text in (f"{answer.question}: {answer.lead}", *answer.details, *answer.points)
        ]
        pictures = rig_svg(self.data.diagnosis), card_svg(self.data)
        return card(self.sentence or self.verdict, *texts, *pictures, self._errors_html())


def result_of(
    home: RunHome,
    rig: str | Rig | None = None,
    effects: tuple[str | type[Effect], ...] = (),
) -> FitResult:
    """The result in a run folder: a DiagnosisResult where it holds a diagnosis. FileError where it
    holds none, or a damaged file; no code of the folder's is run."""
    folder = home.folder
    fit = read_result(folder / FIT_FILE, FitFile)
    diagnosis = read_diagnosis(folder / DIAGNOSIS_FILE)
    if fit is None:
        load_run(folder)  # reports the damage
        raise FileError(
            f"{folder} holds a diagnosis without its fit.json.",
            "Make the run again.",
            code="damaged",
        )
    failed = diagnosis.failed_jobs if diagnosis is not None else fit.failed_jobs
    common: dict[str, Any] = {name: getattr(fit, name) for name in _OF_FIT}
    common |= {
        "folder": folder,
        "combinations": _parameters(fit.combinations),
        "failed_jobs": tuple((failure.job, failure.why) for failure in failed or ()),
        "code": (rig, effects),
        "_home": home,
    }
    parameters = _parameters(fit.parameters)
    if diagnosis is None:
        return FitResult(parameters=parameters, **common)
    where = diagnosis.where
    shares = [(port.port, port.share) for port in where.ports] if where is not None else []
    return DiagnosisResult(
        parameters=_parameters(diagnosis.parameters),
        refitted=parameters,
        ports=tuple(sorted(shares, key=lambda item: -item[1])),
        causes=tuple(
            IdentifiedCause(
                parameters=_parameters(cause.parameters),
                **{name: getattr(cause, name) for name in _OF_CAUSE},
            )
            for cause in diagnosis.causes
        ),
        regimes=tuple(where.regimes) if where is not None else (),
        **{name: getattr(diagnosis, name) for name in _OF_DIAGNOSIS},
        **common,
    )


def _parameters(estimates: Mapping[str, Estimate]) -> ParameterTable:
    table = ParameterTable()
    for name, estimate in estimates.items():
        stated = {field: getattr(estimate, field) for field in Estimate.model_fields}
        stated["unit"] = estimate.unit or ("-" if "/" in name else split_column(name)[1])
        stated["at_bound"] = estimate.at_bound or ""
        table[name] = ParameterEstimate(name=name, **stated)
    return table
