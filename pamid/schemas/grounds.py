"""What the verdict of a diagnosis rests on: its figures, the probabilities made of them, and the
effects that were weighed beside the first."""

from __future__ import annotations

from pydantic import Field

from pamid.schemas.model import Count, Flag, ListOf, Model, Number, NumbersByKey, Text, Written


class Further(Model):
    """An effect that was weighed beside those already found."""

    effect: Text
    family: Text
    removed: Number = Field(description="share of the gap that it removes")
    of_left: Number = Field(description="share that it removes of what the others leave")
    gain: Number = Field(description="log squared error per channel that it gains")
    sure: Number = Field(description="the gain in its standard errors")
    margin: Number = Field(
        description="standard errors by which it beats the next of another family"
    )
    evidence: Number = Field(
        default=0.0,
        description="log evidence that it gains on the fitted data, priors counted, nats",
    )
    at_port: Number = Field(description="evidence at its port over the largest at any")
    unexplained: Number = Field(description="the largest evidence, nats per sample")
    probability: Number = Field(description="of being real, 0 to 1")
    taken: Flag = Field(description="whether it is part of the answer")
    tried: ListOf[ListOf[Text]] = Field(
        default=(),
        description="families of every combination of effects that was refitted, the best first",
    )
    closed: ListOf[Text] = Field(
        default=(),
        description="families not tried beside those found: little is missing where they act",
    )


class SignatureFigures(NumbersByKey):
    """What speaks for an effect, beside the others of its model, on fitted data and on the
    held-out windows."""

    removed: Written[Number] = Field(None, description="share of the gap that it removes")
    of_left: Written[Number] = Field(None, description="the same of what is left without it")
    sure: Written[Number] = Field(None, description="gain in log squared error, in standard errors")
    steady: Written[Number] = Field(
        None, description="share of the windows in which the error is smaller with it"
    )
    lead: Written[Number] = Field(
        None, description="share of the gap that the best model of another family leaves more"
    )
    lead_sure: Written[Number] = Field(None, description="the lead in its standard errors")
    wins: Written[Number] = Field(None, description="share of resamples won by its family")
    at_port: Written[Number] = Field(
        None, description="evidence at its port over the largest at any"
    )
    evidence: Written[Number] = Field(
        None, description="log evidence that it gains on the fitted data, priors counted, nats"
    )
    evidence_lead: Written[Number] = Field(
        None, description="the same over the most evident model without its family, nats"
    )
    eased: Written[Number] = Field(
        None, description="squared strains and pulls that it takes off the rig and the background"
    )
    left: Written[Number] = Field(None, description="share of the gap that remains with it")
    remaining: Written[Number] = Field(
        None, description="error with it over the noise floor, in the worst channel"
    )
    bounds: Written[Number] = Field(
        None, description="its parameters at a bound that physics did not set"
    )
    converged: Written[Number] = Field(None, description="1 or 0")
    beside: Written[Number] = Field(None, description="other effects in its model")


class Grounds(NumbersByKey):
    """What the verdict rests on, all on the held-out windows."""

    visible: Written[Number] = Field(
        None, description="refitted error over the noise floor, in the worst channel"
    )
    gap: Written[Number] = Field(
        None, description="refitted error above the floor, in floors, summed over channels"
    )
    of_signal: Written[Number] = Field(
        None, description="refitted error over the signal's standard deviation, worst channel"
    )
    left: Written[Number] = Field(None, description="share of the gap left by the best model")
    ceiling: Written[Number] = Field(None, description="share of the gap left by the black box")
    shrinkage: Written[Number] = Field(None, description="of the error, by the best model")
    gain: Written[Number] = Field(
        None, description="log squared error per channel that the best model gains"
    )
    sure: Written[Number] = Field(None, description="the gain in its standard errors")
    helps: Written[Number] = Field(
        None, description="share of resamples in which the first candidate helps at all"
    )
    margin: Written[Number] = Field(
        None, description="share of the gap by which the best of another family is worse"
    )
    margin_gain: Written[Number] = Field(
        None, description="the margin in log squared error per channel"
    )
    margin_sure: Written[Number] = Field(None, description="the margin in its standard errors")
    wins: Written[Number] = Field(
        None, description="share of resamples won by the family of the first candidate"
    )
    missing: Written[Number] = Field(
        None, description="evidence that something is missing, nats per sample"
    )
    unexplained: Written[Number] = Field(
        None, description="the same beside the best model, nats per sample"
    )
    at_port: Written[Number] = Field(
        None, description="evidence at the port of the first candidate over the largest at any"
    )
    strain: Written[Number] = Field(
        None, description="largest of a parameter in the best model, in prior standard deviations"
    )
    pull: Written[Number] = Field(
        None, description="largest of the background in the best model, in tolerances"
    )
    channels: Written[Count] = Field(None, description="that are measured")
    remaining: Written[Number] = Field(
        None, description="error of the best model over the noise floor, in the worst channel"
    )
    remaining_of_signal: Written[Number] = Field(
        None, description="the same over the signal's standard deviation"
    )


class Confidence(NumbersByKey):
    """The calibrated probabilities behind the verdict, 0 to 1."""

    gap: Written[Number] = Field(None, description="that there is a structural gap")
    known: Written[Number] = Field(None, description="that the catalogue knows its cause")
    first: Written[Number] = Field(
        None, description="that the first of the ranking, or one that looks like it, is it"
    )
