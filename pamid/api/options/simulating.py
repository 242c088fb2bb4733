"""Arguments of `simulate`, `power` and `score`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

from pamid.api.options.estimating import RIG_TEXT
from pamid.api.options.record import (
    AnyPath,
    FilePath,
    FolderPath,
    argument,
    in_python_only,
    jobs_option,
    known_option,
    noise_option,
    option,
    parse_pairs,
    required_option,
    seed_option,
    which_option,
)

if TYPE_CHECKING:
    from pamid.api.given import EffectLike, RecordingLike, Warn
    from pamid.api.workers import OpenedRun
    from pamid.base.progress import ShowProgress
    from pamid.model.registry import RigLike


@dataclass(frozen=True)
class SimulationArguments:
    """Simulate a virtual rig on an excitation and write the readings of its sensors.

    A reference column drives the rig's controller (closed loop). A command column is replayed (open
    loop). A rig with several joints needs the references of all joints, or all commands. Known
    values in the TOML of the excitation apply to the rig, and the recording states them. The
    recording does not state the effects, the values of --set, or the name of a rig file.
    """

    excitation: RecordingLike = required_option("CSV with time_s and the inputs.")
    rig: RigLike | None = option(None, RIG_TEXT.format("excitation names"))
    _: KW_ONLY
    model: FolderPath | OpenedRun | None = option(
        None,
        "Simulate the result of `pamid fit` or `pamid diagnose`, with its integration steps, "
        "instead of a rig from its data sheet. Repeat --rig and --effect for files of that run.",
        metavar="RUN",
    )
    which: str = which_option("With --model, the model to simulate.")
    effects: EffectLike | Iterable[EffectLike] = option(
        (),
        "NAME, NAME@PORT, with :parameter=value,...; or the path of an effect file (it is run).",
        "--effect",
    )
    known: Mapping[str, float] | None = known_option(
        "Parameter of the virtual rig, written as known value to the TOML of the recording."
    )
    parameters: Mapping[str, float] | None = option(
        None,
        "Parameter of the virtual rig, not written to the TOML of the recording.",
        "--set",
        metavar="NAME=VALUE",
        parse=parse_pairs(),
        click={"envvar": ("PAMID_SIMULATE_PARAMETERS", "PAMID_SIMULATE_HIDDEN")},
    )
    noise: float = noise_option("default | none | FACTOR on the sensor noise.")
    seed: int = seed_option("The same seed gives the same noise.")
    output: FilePath | None = option(None, "CSV file to write.", command_default="simulated.csv")
    overwrite: bool = option(False, "Replace the output if it exists.", formerly="--force")


@dataclass(frozen=True)
class PowerArguments:
    """Predict, before measuring, which effects this experiment would show: from which size on, by
    which single sensor, and which effects it would confuse.

    The experiment is simulated on the rig of the data sheet with the noise of its sensors. An
    effect is detectable if the error of the refitted model exceeds the noise floor by 10 %. The
    part of the effect that parameters and tolerances can absorb does not count. Real machines have
    further irregularities, which are not simulated: read the smallest sizes as the best case.
    """

    excitation: RecordingLike = required_option("CSV with time_s and the planned inputs.")
    rig: RigLike | None = option(None, RIG_TEXT.format("excitation names"))
    _: KW_ONLY
    effects: EffectLike | Iterable[EffectLike] = option(
        (),
        "Path of an effect file to try in addition to the catalogue (it is run).",
        "--effect",
    )
    known: Mapping[str, float] | None = known_option(
        "Parameter that is a known value of the recording."
    )
    noise: float = noise_option("default | FACTOR on the noise of the rig's sensors.")
    seed: int = seed_option("The same seed gives the same noise.")
    jobs: int = jobs_option()
    progress: ShowProgress = in_python_only(None, "As in `pamid.fit`.")


@dataclass(frozen=True)
class ScoreArguments:
    """Score the models of the run folder RUN on new RECORDINGS: data sheet, refitted, with the
    causes, with the network.

    Prints mean absolute errors, and root mean squares in brackets, per recording and channel. Known
    values of a recording (an inertia, a payload) are used. The errors are those of a replay on the
    recorded command, in the windows of a fit, and, in closed loop, under the controller as well. A
    recording that the run used for fit or score is refused.
    """

    run: OpenedRun | AnyPath = argument("Result, or run folder.")
    recordings: RecordingLike | Sequence[RecordingLike] = argument("Recordings to score on.")
    _: KW_ONLY
    rig: RigLike | None = option(
        None, "Path of the run's rig file, if any (it is run if it is unchanged)."
    )
    effects: EffectLike | Iterable[EffectLike] = option(
        (), "Path of an effect file of the run (it is run if it is unchanged).", "--effect"
    )
    warn: Warn | None = in_python_only(
        None, "Function that takes warnings. Default: warnings.warn."
    )
