"""The catalogues of effects and of rigs, as `pamid effects` and `pamid rigs` print them."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.estimates import RIG, UNIT
from pamid.base.schemas.model import Flag, ListOf, Model, Number, Sometimes, Text

ACTS_ON = "kinds of port that it acts on"


class ParameterRow(Model):
    """A parameter with its range."""

    name: Text = Field(description="with unit")
    value: Number = Field(description="typical, or of the data sheet, in the unit of the name")
    low: Number | None = Field(description="lower bound; null for none")
    high: Number | None = Field(description="upper bound; null for none")
    unit: Text = Field(description=UNIT)
    multiple_of: Text = Field(description="value or rate: it is a multiple of that at the port")
    null: Number | None = Field(description="value at which the effect vanishes")
    fitted: Flag
    source: Text = Field(description="source of the value")


class NamedUnit(Model):
    """A parameter or a state by its name alone."""

    name: Text
    unit: Text = Field(description=UNIT)


class EffectPlace(Model):
    """A place at which an effect fits."""

    rig: Text | None = Field(description=RIG)
    effect: Text = Field(description="label, effect@port where the place is not unique")
    ports: ListOf[Text] = Field(description="that it acts on")
    parameters: ListOf[NamedUnit] = Field(description="as they are called there")


class EffectRow(Model):
    """A line of the list of effects."""

    name: Text
    title: Text
    kinds: ListOf[Text] = Field(description=ACTS_ON)
    families: dict[Text, Text] = Field(description="by kind of port")
    home: ListOf[Text] = Field(description="kinds of port for which it is made")
    general: ListOf[Text] = Field(description="kinds of port on any rig")
    symptoms: ListOf[Text] = Field((), description="shapes of the error that it causes")


class EffectStory(EffectRow):
    """Everything about an effect."""

    story: dict[Text, Text] = Field(description="title and sections")
    signals: ListOf[Text] = Field(description="that it cannot do without")
    stand_ins: dict[Text, ListOf[Text]] = Field(
        description="signal -> names under which a port may offer it instead"
    )
    roles: ListOf[ListOf[Text]] = Field(
        description="it acts at several ports together: the signals of each part"
    )
    unit: Text = Field(description=UNIT)
    parameters: ListOf[ParameterRow]
    home_signals: ListOf[Text] = Field(
        description="signals without which a port belongs to the general catalogue"
    )
    general_parameters: ListOf[ParameterRow] = Field(
        description="the same parameters at ports of the general catalogue, where they differ"
    )
    states: ListOf[Text]
    look_alikes: ListOf[Text] = Field(description="effects that it is mistaken for")
    absorbed_by: ListOf[Text] = Field(description="parameters of a rig that can stand in for it")
    places: ListOf[EffectPlace] = Field(description="where it fits on the rigs looked at")


class EffectCatalogue(
    Model,
    schema="pamid.effects/1",
    title="pamid effects: the catalogue of effects, or a single effect",
):
    """All effects, or a single effect."""

    effect: Sometimes[EffectStory] = Field(default=None, description="the requested effect")
    effects: Sometimes[ListOf[EffectRow]] = Field(default=None, description="sorted by name")


class RigInput(Model):
    """A column that goes in."""

    column: Text
    unit: Text = Field(description=UNIT)
    optional: Flag


class RigOutput(Model):
    """A column that comes out."""

    column: Text
    unit: Text = Field(description=UNIT)
    noise: Number | None = Field(description="standard deviation by the data sheet")


class RigPort(Model):
    """A place at which effects may act."""

    name: Text
    kind: Text
    unit: Text = Field(description=UNIT)
    places: ListOf[Text] = Field(description="several of a kind, by name")
    group: Text = Field(description="group of ports in which it is reported")
    signals: dict[Text, Text] = Field(description="that it offers, with their units")
    effects: ListOf[Text] = Field(description="that fit there, by name")


class BackgroundRow(Model):
    """A tolerance-sized correction in every model."""

    name: Text
    port: Text
    terms: ListOf[Text] = Field(description="its parameters")
    tolerance: Number = Field(description="prior standard deviation")


class LoopRow(Model):
    """A control loop."""

    command: Text
    reference: Text
    reading: Text


class RigEquations(Model):
    """The equations as text, SI; whatever passes through a port bears its name."""

    rates: dict[Text, Text]
    ports: dict[Text, Text]
    outputs: dict[Text, Text]
    where: dict[Text, Text] = Field(description="shorthands used in the others")


class RigRow(Model):
    """A line of the list of rigs."""

    name: Text
    title: Text
    inputs: ListOf[Text] = Field(description="input columns")
    outputs: ListOf[Text] = Field(description="output columns")
    variants: ListOf[Text] = Field(description="named as rig:variant")


class NoPlaceRow(Model):
    """Effects that this rig has no place for, while others for the same quantities have."""

    effects: dict[Text, Text] = Field(description="effect -> description")
    needs: Text = Field(description="the port that they take")
    rigs: ListOf[Text] = Field(description="rigs of the catalogue that have it")


class RigStory(Model):
    """Everything about a rig."""

    name: Text
    title: Text
    story: dict[Text, Text] = Field(description="title and sections")
    inputs: ListOf[RigInput]
    outputs: ListOf[RigOutput]
    variants: ListOf[Text] = Field(description="named as rig:variant")
    states: ListOf[NamedUnit]
    ports: ListOf[RigPort]
    no_place: ListOf[NoPlaceRow] = ()
    parameters: ListOf[ParameterRow]
    on_request: ListOf[Text] = Field(
        (), description="names that release several parameters at once under [free]"
    )
    background: ListOf[BackgroundRow]
    loops: ListOf[LoopRow]
    equations: RigEquations


class RigCatalogue(
    Model, schema="pamid.rigs/1", title="pamid rigs: the catalogue of rigs, or a single rig"
):
    """All rigs, or a single rig."""

    rig: Sometimes[RigStory] = Field(default=None, description="the requested rig")
    rigs: Sometimes[ListOf[RigRow]] = None
