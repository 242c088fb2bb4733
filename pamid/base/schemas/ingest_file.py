"""Conversion record of a raw log, in the file next to each recording made from it."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.command_files import LOOP
from pamid.base.schemas.estimates import PERIOD, RIG, UNIT
from pamid.base.schemas.model import Count, Flag, ListOf, MapOf, Model, Number, Sometimes, Text
from pamid.base.schemas.run_file import InputFile


class LogRead(InputFile):
    """The raw log."""

    kind: Text = Field(description="its format")
    details: ListOf[Text] = Field(description="decisions of the reader, a clause each")


class TimeMapped(Model):
    """Settings of the time base in the mapping."""

    source: Sometimes[Text] = Field(default=None, description="channel with the stamps")
    unit: Sometimes[Text] = Field(default=None, description=UNIT)
    period_s: Sometimes[Number] = Field(default=None, description=PERIOD)
    repair: Text
    max_gap_s: Sometimes[Number] = Field(
        default=None, description="longer gaps split the recording"
    )


class ChannelMapped(Model):
    """Conversion of a channel to a column in the mapping."""

    source: Text = Field(description="channel of the log")
    unit: Sometimes[Text] = Field(default=None, description=UNIT)
    scale: Sometimes[Number] = None
    pressure: Sometimes[Text] = Field(default=None, description="gauge or absolute")
    sign: Count
    offset: Number
    rows: Sometimes[Count] = Field(default=None, description="delay of its values in rows")
    interpolation: Sometimes[Text] = Field(default=None, description="hold or smooth")


class AtmosphereTaken(Model):
    """Atmospheric pressure subtracted from absolute pressures."""

    pressure_kpa: Number


class MappingUsed(InputFile):
    """The mapping, with the settings of the command line."""

    rig: Sometimes[Text] = Field(default=None, description=RIG)
    loop: Sometimes[Text] = Field(default=None, description=LOOP)
    time: Sometimes[TimeMapped] = None
    signals: MapOf[ChannelMapped] = Field(description="by column")
    atmosphere: Sometimes[AtmosphereTaken] = None
    known: Sometimes[dict[Text, Number]] = Field(
        default=None, description="known parameters of the rig, by name with unit"
    )
    controller: Sometimes[dict[Text, Number]] = Field(default=None, description="its settings")
    between: Sometimes[dict[Text, Text]] = Field(
        default=None, description="held or linear between samples, by column"
    )


class ClockWitness(Model):
    """A smooth signal that was used to diagnose uneven stamps."""

    signal: Text
    coefficient: Number
    error: Number
    roughness_ratio: Number


class ClockRepair(Model):
    """A repair of a time base."""

    what: Text = Field(description="a stable word for scripts")
    count: Count
    detail: Text = Field(description="in words")


class ClockUsed(Model):
    """A time base of the log."""

    name: Text
    rows: Count
    state: Text
    cure: Text | None = Field(description="repair of uneven stamps")
    why: Text = Field(description="the reason, in words")
    numbers: Sometimes[dict[Text, Number]] = Field(default=None, description="behind the reason")
    signals: Sometimes[ListOf[ClockWitness]] = None
    repairs: ListOf[ClockRepair]
    leads: Flag = Field(description="whether it is the time base of the recording")


class ColumnMade(Model):
    """A column of the recording."""

    source: Text = Field(description="channel of the log")
    clock: Text = Field(description="name of its time base")
    interpolation: Text = Field(description="hold or smooth")
    empty_cells: Count
    longest_empty_run: Count
    at_limit: Count = Field(description="samples in runs at the highest or lowest value")
    filtered: Flag = Field(description="whether it was filtered before it was resampled")
    unit: Sometimes[Text] = Field(default=None, description="of the channel")
    atmosphere_taken_off_kpa: Sometimes[Number] = None


class RecordingMade(Model):
    """The recording that was written."""

    path: Text
    samples: Count = Field(description="number of samples")
    sampling_period_s: Number
    duration_s: Number
    columns: ListOf[Text]
    begins_s: Number = Field(description="on the clock of the log")
    first_row: Count = Field(description="of the log")


_ACCOUNT = ("source", "mapping", "clock_ppm", "clocks", "signals", "notes", "recording")


class IngestFile(
    Model,
    schema="pamid.ingest/1",
    title="pamid ingest, and the conversion record next to a recording from a raw log",
    json_schema_extra={"oneOf": [{"required": [*_ACCOUNT]}, {"required": ["recordings"]}]},
):
    """Conversion record of a recording; in the command's output, of all recordings."""

    source: Sometimes[LogRead] = None
    mapping: Sometimes[MappingUsed] = None
    clock_ppm: Sometimes[Number] = Field(
        default=None,
        description="how much faster the clock of the log runs than the stated period",
    )
    clocks: Sometimes[ListOf[ClockUsed]] = None
    signals: Sometimes[MapOf[ColumnMade]] = Field(default=None, description="by column")
    notes: Sometimes[ListOf[Text]] = Field(default=None, description="a sentence each")
    recording: Sometimes[RecordingMade] = None
    recordings: Sometimes[ListOf[IngestFile]] = Field(
        default=None, description="in the command's output: a record per recording"
    )
