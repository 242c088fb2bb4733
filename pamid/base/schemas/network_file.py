"""network.json: a trained network with all that is needed to use it, but for its weights."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field, PlainValidator, ValidationInfo, WithJsonSchema

from pamid.base.schemas.estimates import CONVERGED, SHA256, WHY_ENDED
from pamid.base.schemas.model import (
    MAY_LACK,
    Count,
    Flag,
    ListOf,
    MapOf,
    Model,
    Number,
    NumbersOnly,
    Sometimes,
    Text,
    Written,
    number,
)


class ScaledSignal(Model):
    """A signal that the network takes or gives, and the range that is scaled to -1 .. 1."""

    not_read: ClassVar = ("low", "high")

    name: Text = Field("", description="with unit")
    low: Written[Number] = Field(None, description="smallest value in training")
    high: Written[Number] = Field(None, description="largest value in training")


#: in the end; null where it is not finite
Last = Annotated[Number | None, MAY_LACK]


class TrainingSummary(Model):
    """How the training went."""

    model_config = ConfigDict(extra="allow")
    not_read: ClassVar[tuple[str, ...]] = (
        "mse",
        "gradient",
        "mu",
        "gamma",
        "alpha",
        "beta",
        "n_weights",
        "supported_weights",
        "samples",
        "effective_samples",
        "start",
        "starts_mse",
        "plain",
    )

    why: Annotated[Text, MAY_LACK] = Field(default="", description=WHY_ENDED)
    converged: Annotated[Flag, MAY_LACK] = Field(default=True, description=CONVERGED)
    remark: Annotated[Text, MAY_LACK] = Field(default="", description="warning; else empty")
    iterations: Sometimes[Count] = None
    mse: Last = Field(default=None, description="mean squared error, of the scaled output")
    gradient: Last = Field(default=None, description="norm of the gradient of the objective")
    mu: Last = Field(default=None, description="damping of Levenberg and Marquardt")
    gamma: Last = Field(default=None, description="weights that the data support")
    alpha: Last = Field(default=None, description="precision of the weights' prior")
    beta: Last = Field(default=None, description="precision of the noise")
    n_weights: Sometimes[Count] = None
    supported_weights: Last = Field(default=None, description="gamma, of all starts' best")
    samples: Sometimes[Count] = None
    effective_samples: Last = Field(default=None, description="less for correlated errors")
    start: Sometimes[Count] = Field(default=None, description="number of the best start")
    starts_mse: Annotated[ListOf[Number | None], MAY_LACK] = Field(
        default=(), description="of every start; null where it is not finite"
    )
    plain: Sometimes[Flag] = Field(
        default=None,
        description="whether by plain Levenberg-Marquardt steps from a random start, as in the "
        "first paper",
    )


def _figure(value: Any, info: ValidationInfo) -> Any:
    return value if info.context is None else number(value, info)


Figure = Annotated[
    float, PlainValidator(_figure), WithJsonSchema({"type": ["number", "string", "null"]})
]
ChannelErrors = Annotated[dict[Text, Figure], NumbersOnly]
ANY_SIZE = {"type": ["integer", "string"]}


class WeightsFile(Model):
    """The file that holds the weights."""

    file: Text
    sha256: Text = Field(description=SHA256)


class NetworkFile(Model, schema="pamid.network/1", title="network.json and pamid train-residual"):
    """A trained network: sizes, signals and scaling, and how the training went."""

    not_read: ClassVar = (
        "sizes",
        "inputs",
        "period_s",
        "weights",
        "enters",
        "parameters",
        "notes",
    )

    kind: Text = Field("network", description="elman, narx, anfis")
    sizes: dict[Text, Annotated[Any, WithJsonSchema(ANY_SIZE)]] = Field(
        {}, description="sizes of this kind of network, by name"
    )
    n_weights: Written[Count] = None
    inputs: ListOf[ScaledSignal] = Field((), description="in the network's order")
    output: Written[ScaledSignal] = None
    period_s: Written[Number] = Field(None, description="sampling period that it is good for, s")
    training: Written[TrainingSummary] = None
    weights: Written[WeightsFile] = None
    enters: Sometimes[Annotated[Any, WithJsonSchema({"type": ["string", "object"]})]] = Field(
        default=None, description='"output", or {"port": where its value enters the equations}'
    )
    model: Sometimes[Text] = Field(
        default=None,
        description="model that it corrects: the replayed model (replay), or the model in closed "
        "loop (loop)",
    )
    on: Sometimes[Text] = Field(
        default=None,
        description="the model whose residual it was trained on: refitted (refit), or the "
        "model with the causes of the diagnosis (causes)",
    )
    target: Sometimes[Text] = Field(default=None, description="training target, in words")
    parameters: Sometimes[dict[Text, Number]] = Field(
        default=None, description="fitted ones of the model that it corrects from within, by name"
    )
    mae: Sometimes[MapOf[ChannelErrors]] = Field(
        default=None,
        description="mean absolute error in the unit of the channel: channel -> refitted, "
        "with_cause, with_network ..., and `part` in words",
    )
    notes: Sometimes[ListOf[Text]] = Field(default=None, description="a sentence each")

    @property
    def in_loop(self) -> bool:
        """It corrects the model in its loop, so its errors do not compare with those of the
        replay."""
        return self.model == "loop"

    @property
    def on_causes(self) -> bool:
        """It was trained on what the model with the causes leaves over."""
        return self.on == "causes"

    @property
    def summary(self) -> TrainingSummary:
        return self.training or TrainingSummary()

    @property
    def errors(self) -> dict[str, dict[str, float]]:
        return self.mae or {}
