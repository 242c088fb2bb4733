"""Errors of models, recording by recording."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.estimates import RIG
from pamid.base.schemas.model import Count, ListOf, MapOf, Model, Number, Text

BY_MODEL = "in the unit of the channel, by model; null where the model became unstable"


class RecordingError(Model):
    """Errors of every model in a channel of a recording."""

    recording: Text = Field(description="its name")
    known: dict[Text, Number] = Field(
        description="known values of the recording, by name with unit: its inertia, payload"
    )
    comparison: Text = Field(
        description="replay: on the recorded command, window by window; loop: under the "
        "controller, from the beginning to the end"
    )
    channel: Text = Field(description="by name with unit")
    samples: Count = Field(description="number of samples that are scored")
    mae: MapOf[Number | None] = Field(description=f"mean absolute error, {BY_MODEL}")
    rms: MapOf[Number | None] = Field(description=f"root of the mean squared error, {BY_MODEL}")


class ScoreFile(
    Model, schema="pamid.score/1", title="pamid score: errors of a run's models on new recordings"
):
    """Errors of a run's models on new recordings."""

    run: Text = Field(description="folder of the run")
    rig: Text = Field(description=RIG)
    models: ListOf[Text] = Field(
        description="data_sheet, refitted, with_cause, with_network: those that the run has"
    )
    recordings: ListOf[RecordingError] = Field(description="per recording, comparison and channel")
    notes: ListOf[Text] = Field(description="a sentence each")
