"""Arguments of `fit` and `diagnose`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

from pamid.api.options.record import (
    EffectName,
    FolderPath,
    argument,
    cluster_option,
    in_python_only,
    jobs_option,
    option,
    parse_pairs,
    run_output_option,
    seed_option,
)

if TYPE_CHECKING:
    from pamid.api.given import EffectLike, RecordingLike, Warn
    from pamid.api.workers import OpenedRun
    from pamid.base.progress import ShowProgress
    from pamid.base.run_folder import Run
    from pamid.diagnosis.settings import Settings
    from pamid.model.registry import RigLike

RIG_TEXT = (
    "Rig by name, or the path of a file: a rig file (it is run), a MuJoCo or URDF model, or an FMU "
    "(its binary is run). [default: the rig that the {}, else one-dof]"
)


@dataclass(frozen=True)
class RecordingArguments:
    """Recordings to fit and to score on, and their rig."""

    recordings: RecordingLike | Sequence[RecordingLike] = argument(
        "Recordings to fit: objects, paths, or tables with the column time_s."
    )
    rig: RigLike | None = option(None, RIG_TEXT.format("recordings name"))
    _: KW_ONLY
    held_out: RecordingLike | Sequence[RecordingLike] = option(
        (),
        "Recording to score on, not used for the fit. [default: the last 30 % of every recording; "
        "30 % in several parts if the recording rests for part of its length]",
    )


@dataclass(frozen=True, kw_only=True)
class RunArguments:
    """Arguments of the run of a fit or a diagnosis."""

    seed: int = seed_option("The same inputs and seed give the same output.")
    jobs: int = jobs_option()
    output: FolderPath | Run | None = run_output_option("run")
    check: bool = option(
        True,
        "Fit the recordings even if `pamid check` finds faults for this rig.",
        negated=True,
        in_python="Refuse recordings with which a fit of this rig is meaningless.",
    )
    cluster: str | None = cluster_option()
    resume: bool = option(False, "Continue the same run where it was interrupted.")
    overwrite: bool = option(False, "Replace an earlier run in that folder.")
    progress: ShowProgress = in_python_only(
        None,
        "None: a line that updates itself; False: silent; or a function of a line of text.",
    )
    warn: Warn | None = in_python_only(
        None, "Function that takes warnings. Default: warnings.warn."
    )
    command: Sequence[str] = in_python_only((), "Command that the run notes. Default: this call.")


@dataclass(frozen=True, kw_only=True)
class FittedModel(RecordingArguments):
    """Model of a fit, and its intervals."""

    effects: EffectLike | Iterable[EffectLike] = option(
        (),
        "Effect to fit with: NAME or NAME@PORT, or the path of an effect file (it is run).",
        "--effect",
    )
    earlier: FolderPath | OpenedRun | None = option(
        None,
        "Run of an earlier fit of the same rig. Its estimates become the priors of this fit; "
        "parameters that it did not determine keep the prior of the data sheet.",
        "--from",
    )
    bootstrap: int = option(
        0,
        "Intervals from this many refits on resampled windows instead of the Jacobian.",
        least=0,
        most=1000,
    )


@dataclass(frozen=True, kw_only=True)
class FitArguments(RunArguments, FittedModel):
    """Fit the parameters of a rig to recordings and score the model on held-out data.

    Writes fit.json and residual.csv into a run folder. Every parameter gets an interval and a
    grade. settled: the recordings determine it. weak: the prior contributes. silent: the recordings
    do not depend on it, so that its value is that of the data sheet. If the recordings determine
    only a combination of parameters, the combination is listed with them.

    Experiments can be fitted in stages, each on other recordings: give the run folder of each fit
    to the next with --from.
    """

    jobs: int = jobs_option("Processes for the bootstrap.", 1)
    output: FolderPath | Run | None = run_output_option("fit-run")
    resume: bool = option(
        False,
        "Continue the same fit where it was interrupted. Finished draws of the bootstrap are "
        "reused.",
    )


@dataclass(frozen=True, kw_only=True)
class SearchedEffects(RecordingArguments):
    """Effects of a diagnosis, and its thresholds."""

    effects: EffectLike | Iterable[EffectLike] = option(
        (), "File with a further effect to consider (it is run).", "--effect"
    )
    without: Sequence[EffectName] = option((), "Effect of the catalogue to leave out.")
    horizon: str | float | None = option(
        None,
        "Time to predict from an estimated state, rounded to whole windows; whole: over whole "
        "recordings. [default: as long as the noise of that state allows]",
        metavar="SECONDS|whole",
    )
    settings: Settings | Mapping[str, float] | None = option(
        None,
        "Threshold or bound of the cost to change, for example refits=12.",
        "--setting",
        metavar="NAME=VALUE",
        parse=parse_pairs("For example refits=12."),
    )


@dataclass(frozen=True, kw_only=True)
class DiagnosisArguments(RunArguments, SearchedEffects):
    """Find where a model departs from its recordings, which effect of the catalogue causes it, and
    how far the gap shrinks when that effect is added. The last figure comes from recordings that
    were used neither to fit the parameters nor to choose the effect.

    If the command is interrupted or killed, every finished job stays in the run folder (jobs/,
    removed at the end). The same command with --resume repeats none of them. If single jobs fail,
    the other results are written, and the exit code is 6.
    """

    output: FolderPath | Run | None = run_output_option("diagnose-run")
    resume: bool = option(False, "Continue the same diagnosis where it was interrupted.")
