"""`pamid.score`: the models of a run on recordings that it has not seen."""

from __future__ import annotations

from pamid.api.given import (
    effects_given,
    recording_given,
    recordings_given,
    unknown_columns,
    warn_in_python,
)
from pamid.api.options.record import verb
from pamid.api.options.simulating import ScoreArguments
from pamid.api.run_score import score_run
from pamid.api.workers import OpenedRun
from pamid.base.errors import UsageError
from pamid.base.schemas.score_file import ScoreFile
from pamid.model.registry import catalogue_rig, in_catalogue, resolved_rig
from pamid.report.recording_errors import recording_errors_text


class ScoreResult(ScoreFile):
    """Errors of a run's models on recordings that were not used before.

    rig: its name; models: "data_sheet", "refitted", "with_cause", "with_network", those that the
    run has; recordings: a row per recording, comparison ("replay", "loop") and channel, with `mae`
    and `rms` by model in the channel's unit, and what the recording states as `known`.
    """

    to_dict = ScoreFile.as_json

    def summary(self) -> str:
        """The table, as lines of text."""
        return "\n".join([recording_errors_text(self.recordings), *self.notes])

    def __repr__(self) -> str:
        return f"<ScoreResult of {self.rig}>\n{self.summary()}"


@verb(ScoreArguments)
def score(arguments: ScoreArguments) -> ScoreResult:
    """Score the models of a run on new recordings: data sheet, refitted, with causes, with network.

    Errors are mean absolute and root mean square, per recording and channel; in replay of the
    recorded command, and under the controller where it ran.

    Raises
    ------
    PamidError
        A recording was used in the run, or does not fit its rig.
    """
    given = recordings_given(arguments.recordings)
    if not given:
        raise UsageError("There is no recording to score the run on.", "Give a recording.")
    run = OpenedRun.of(arguments.run)
    rig = resolved_rig(arguments.rig) or run.code[0]
    effects = effects_given(arguments.effects) or run.code[1]
    read = [recording_given(item, f"recording-{k + 1}") for k, item in enumerate(given)]
    scores = score_run(run.folder, read, rig=rig, effects=effects)
    warn = arguments.warn or warn_in_python
    for recording in read:
        texts = list(recording.warnings)
        if in_catalogue(scores.rig):
            texts += unknown_columns(catalogue_rig(scores.rig), recording)
        for text in texts:
            warn(f"{recording.path}: {text}")
    return ScoreResult(**dict(scores))
