"""Models that several result files share: a value with its interval, a failed job."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pamid.base.schemas.model import MAY_LACK, Model, Number, Sometimes, Text, Written

UNIT = "as people write it; empty for none"
SHA256 = "of the bytes of the file, hexadecimal"
SEED = "seed of every random draw"
RIG = "name of the rig, or path of its file"
PERIOD = "sampling period, s"
LOW = "lower end of the 95 % interval"
HIGH = "upper end of the 95 % interval"
SHARE = "0 to 1"
SHRINKAGE = "1 - error with the cause / error of the refitted model, on held-out data"
WHY_ENDED = "why the optimiser stopped, in words"
CONVERGED = "whether the optimiser came to its end"
EFFECTS = "labels, effect@port where the place is not unique"
WORD = "how well the data know it: settled, weak, silent (all from the prior), or read off them"
PRIOR = "from the data sheet, or an earlier fit"
STRAIN = "distance from the prior in its standard deviations"
AT_BOUND = "low or high: the bound that it lies at; null between them"


class Interval(Model):
    """A value with its 95 % interval, in the unit that the key ends with."""

    value: Number = Field(description="in the unit that the key ends with")
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)


class Estimate(Interval):
    """A fitted parameter; of a verdict's effects the value, interval, unit and word alone."""

    prior: Sometimes[Number] = Field(default=None, description=PRIOR)
    unit: Written[Text] = Field(None, description=UNIT)
    word: Text = Field("", description=WORD)
    at_bound: Annotated[Text | None, MAY_LACK] = Field(default=None, description=AT_BOUND)
    strain: Sometimes[Number] = Field(default=None, description=STRAIN)
    source: Annotated[Text, MAY_LACK] = Field(
        default="", description="where the data-sheet value comes from"
    )
    null: Annotated[Number | None, MAY_LACK] = Field(
        default=None,
        description="of an effect: the value at which it vanishes; null where it never does",
    )


class FailedJob(Model):
    """A part of the work without a result; the rest goes on, and the exit code is 6."""

    job: Text = Field(description="name of the job")
    why: Text = Field(description="why it failed")
