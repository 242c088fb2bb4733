"""JSON of pamid runs and pamid report --compare: runs with their results."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.estimates import RIG
from pamid.base.schemas.model import Figures, ListOf, MapOf, Model, Text


class RunSummary(Model):
    """A run folder at a glance."""

    path: Text = Field(description="folder of the run")
    kind: Text = Field(description="diagnosis, fit, trial, paper, other or damaged")
    command: Text = Field(description="name of its command")
    rig: Text = Field(description=RIG)
    recordings: ListOf[Text] = Field(description="names of the recordings")
    begun: Text = Field(description="UTC, ISO 8601")
    outcome: Text = Field(description="how it ended; empty while it runs")
    verdict: Text = Field(description="of a diagnosis, as in diagnosis.json")
    sentence: Text = Field(description="result in words, or the damage")
    causes: ListOf[Text] = Field(description="labels of the effects that the verdict names")
    mae: MapOf[Figures] = Field(
        description="held-out mean absolute error in the channel's unit: channel -> model",
    )


class RunList(
    Model, schema="pamid.runs/1", title="pamid runs: the runs below a folder with their results"
):
    """The runs below a folder."""

    folder: Text = Field(description="searched folder")
    runs: ListOf[RunSummary] = Field(default=(), description="by path")


class WrittenComparison(
    Model, schema="pamid.comparison/1", title="pamid report --compare: a comparison of runs"
):
    """A page that compares runs."""

    page: Text = Field(description="path of the page")
    runs: ListOf[RunSummary] = Field(
        default=(), description="in the order in which they were given"
    )
    changed: ListOf[Text] = Field(default=(), description="differences in data and settings")
