"""Arguments of `ingest` and `guess_mapping`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, Literal

from pamid.api.options.names import cures
from pamid.api.options.record import (
    AnyPath,
    FilePath,
    argument,
    in_python_only,
    known_option,
    option,
)

if TYPE_CHECKING:
    from pamid.base.progress import ShowProgress
    from pamid.model.registry import RigLike

RIG_TEXT = "Rig by name, or the path of a rig file (it is run)."


def angles_option() -> Any:
    text = "of all angles for which the log states none."
    return option(None, f"With --guess: unit {text}", in_python=f"Unit {text}")


def only_option() -> Any:
    text = "for a log with several robots: use channels whose names contain this."
    return option(None, f"With --guess, {text}", metavar="TEXT", in_python=text.capitalize())


@dataclass(frozen=True, kw_only=True)
class LogArguments:
    """Arguments of both functions."""

    pressures: Literal["gauge", "absolute"] | None = option(
        None, "Kind of all pressures of the log. Required if the mapping does not state it."
    )
    period: float | None = option(
        None,
        "Sampling period of a log without a clock. Required if the mapping does not state it.",
        metavar="SECONDS",
        above=0.0,
    )
    known: Mapping[str, float] | None = known_option(
        "Parameter of the rig known for these recordings, as inertia_kg_m2=0.0896. Overrides the "
        "mapping."
    )
    kind: str | None = option(
        None, "Format of the logs, if their name and content do not determine it."
    )
    memory_limit: float | None = option(
        None,
        "Most memory for reading a log, in GiB. A log that declares more is refused before it is "
        "read. [default: 1]",
        metavar="GIB",
        above=0.0,
    )
    overwrite: bool = option(False, "Replace outputs that exist.")


@dataclass(frozen=True)
class IngestArguments(LogArguments):
    """Convert raw LOGS to recordings: units, signs, gauge pressures, an even time base.

    First write a mapping with `--guess`, and check it. With the mapping, each log becomes a CSV, a
    TOML next to it, and a record of all conversions (.ingest.json). Uneven stamps are diagnosed and
    repaired. If the data do not determine the repair, an error names the options. A long gap splits
    the recording and is never bridged. If a log has several recordings, each becomes a separate
    CSV; `*` in the mapping stands for its part. In a robot's log (ROS JointState, LeRobot, MuJoCo's
    vectors) `--guess` finds the joints and motors of a model by name or order.
    """

    logs: AnyPath | Sequence[AnyPath] = argument("Log, or several with the same mapping.")
    mapping: FilePath | None = option(None, "TOML that assigns channels to columns.")
    _: KW_ONLY
    rig: RigLike | None = option(None, f"{RIG_TEXT} Default: the rig that the mapping names.")
    repair: str | None = option(
        None,
        "Repair of uneven stamps. Overrides the mapping's time.repair.",
        "--time-base",
        choices=cures(),
    )
    output: AnyPath | None = option(
        None,
        "CSV file (several recordings are numbered) or folder. A TOML file and a conversion record "
        "are written next to each recording, all of them or none. Default: nothing is written.",
    )
    progress: ShowProgress = in_python_only(None, "As in `pamid.fit`.")


@dataclass(frozen=True)
class MappingArguments(LogArguments):
    """Write a first mapping from a log to a rig's columns, as TOML with comments to check."""

    log: AnyPath = argument("Log.")
    rig: RigLike | None = option(None, f"{RIG_TEXT} Default: every channel keeps its name.")
    _: KW_ONLY
    angles: Literal["deg", "rad"] | None = angles_option()
    only: str | None = only_option()
    output: AnyPath | None = option(None, "TOML file to write. Default: none.")
