"""Arguments of `check` and `new_rig`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

from pamid.api.options.record import FilePath, RigName, argument, option
from pamid.base.errors import UsageError

if TYPE_CHECKING:
    from pamid.api.given import RecordingLike
    from pamid.model.effect import Effect
    from pamid.model.registry import RigLike
    from pamid.model.rig import Rig


@dataclass(frozen=True)
class CheckArguments:
    """List the contents and all faults of FILE: a recording, a rig file, an effect file or a MuJoCo
    or URDF model.

    A recording (.csv): sampling, and range, rest, noise and resolution of every column. Faults are
    clipped, frozen, lost, bridged, spiked, coarse or hardly excited signals. With a rig, further
    faults are exchanged columns, opposite signs, wrong units, delays and inputs beyond their range.
    The check also determines whether each input is held or linear between samples.

    A rig (.py): whether its equations build, every port is used, all values stay finite over the
    bounds, and sensitivities are exact. Every port is listed with its quantity, its sign and the
    effects that can act there, also those that a further signal would allow.

    A model (.xml, .urdf): the same, after a list of the elements that are left out, with their
    lines.

    An effect (.py): whether its data sheet is complete, whether it vanishes exactly at amount zero,
    and whether it can be computed at every port where it fits.

    Long lists are shortened on the screen, and complete with --all and --json. The exit code is 3
    if there is a fault, and 0 if there are only notes.
    """

    subject: RecordingLike | type[Rig] | type[Effect] | Rig = argument(
        "Recording, its path or a table; rig or effect, or the path of its file, which is run.",
        metavar="FILE",
    )
    rig: RigLike | None = option(
        None,
        "Rig of the recording, by name or file. [default: as its TOML names it]",
    )


def _parse_columns(pairs: tuple[str, ...]) -> dict[str, str]:
    """("force_n=drive_v", ...) as a table."""
    columns = {}
    for pair in pairs:
        wanted, _, recorded = (word.strip() for word in pair.partition("="))
        if not wanted or not recorded:
            raise UsageError(
                f"--column {pair!r} is not RIG_COLUMN=COLUMN.", "For example force_n=drive_v."
            )
        columns[wanted] = recorded
    return columns


@dataclass(frozen=True)
class NewRigArguments:
    """Write a rig file for RECORDING: the rig of the catalogue (`pamid rigs`) that its columns fit
    best, with these columns as inputs and outputs, in their units.

    A column is identified by its name, by a word of the name, or by its unit. An unscaled signal,
    such as a level in volts, gets a gain to fit. Comments in the file list the other columns. The
    values are those of the example, with wide priors: replace each value marked GUESS by yours.

    A rig file is code and is run when you name it. This command runs no code.
    """

    recording: RecordingLike = argument("Recording, its path or a table.")
    _: KW_ONLY
    like: RigName | None = option(
        None,
        "Rig to start from. [default: whose columns fit best]",
        "--like",
        "--rig",
    )
    columns: Mapping[str, str] | None = option(
        None,
        "Column of the rig and the column of the recording for it, if the name does not match.",
        "--column",
        metavar="RIG_COLUMN=COLUMN",
        parse=_parse_columns,
    )
    output: FilePath = option("my_rig.py", "Rig file to write; its name becomes the rig's.")
    overwrite: bool = option(False, "Replace the file if it exists.")
