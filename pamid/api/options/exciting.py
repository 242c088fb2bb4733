"""Arguments of `pamid generate-aprbs`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pamid.api.options.record import (
    FilePath,
    RigName,
    option,
    parse_pairs,
    seed_option,
)
from pamid.base.errors import UsageError


def _parse_amplitudes(texts: tuple[str, ...]) -> dict[str, float]:
    """("20", "reference_2_deg=30") as a table; "" stands for every column."""
    amplitudes = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            amplitudes[name.strip()] = float(number)
        except ValueError:
            raise UsageError(
                f"--amplitude {text!r} is not a number.", "Write 20, or reference_2_deg=30."
            ) from None
    return amplitudes


# on references and commands
_SIGNALS = ("aprbs", "prbs", "multisine", "chirp", "steps", "staircase")
SEEDED = ("aprbs", "prbs", "multisine", "steps", "staircase")


@dataclass(frozen=True, kw_only=True)
class ExcitationArguments:
    """Generate an informative excitation for a rig: random steps (APRBS), chirps and other signals,
    torque loops, valve pulses or a gravity test. `pamid excite` is the same command.

    \b
    aprbs         independent random steps on the reference of every joint, or on every command
    prbs          two levels, by a shift register whose order is the longest hold over the shortest
    multisine     odd harmonics of equal height with a low peak; nonlinearity shows between them
    chirp         a sine of rising frequency, through the band
    steps         steps there and back, repeatedly
    staircase     there and back with growing steps: --loop open for the smallest duties that move
    torque-loops  an external torque up and down, with shut valves, at --pressure

    Random signals excite all joints together, other signals the joints in turn. Prints how
    well they cover amplitude and frequency, and what they cannot excite.

    valve-pulses: pulses of 30 to 500 ms that bypass the controller, every 1.5 s, to vent and fill
    the muscles in turn. gravity-test: no command; the rig swings after its release, with
    vented muscles.

    Writes a CSV (time_s and the columns to send), or what Simulink, a PLC or a C program plays: mat
    and mat-matrix for From Workspace, mat-file for From File, st with change points, h with samples
    and change points. Next to it a JSON file with what they are and their sha256 and, where the rig
    has to be set to something, a TOML file with it. `pamid simulate` reads CSV and TOML.
    """

    experiment: Literal["aprbs", "valve-pulses", "gravity-test"] = option(
        "aprbs",
        "A signal (--signal), pulses on the valves, or a swing with the muscles vented.",
    )
    signal: Literal["aprbs", "prbs", "multisine", "chirp", "steps", "staircase", "torque-loops"] = (
        option("aprbs", "Kind of signal; see below.")
    )
    rig: RigName = option("one-dof", "Rig to excite.")
    loop: Literal["closed", "open"] = option(
        "closed",
        "Excite the references of the controllers, or the commands themselves.",
        applies_to=_SIGNALS,
    )
    column: str | None = option(
        None,
        "Name of the column, for a rig outside the catalogue (e.g. force_n).",
        applies_to=_SIGNALS,
    )
    duration: float | None = option(
        None,
        "Length in s. [default: 200, or 125 of the rig's longest holds; gravity test: 20; torque "
        "loops: a single pass]",
        applies_to=("aprbs", "prbs", "multisine", "chirp", "steps", "torque-loops", "gravity-test"),
    )
    period: float | None = option(
        None, "Sampling period in s. [default: the rig's; one-dof: 0.003]"
    )
    amplitude: Mapping[str, float] = option(
        (),
        "Levels lie within +- this, in the unit of the column. [default: the rig's; one-dof: 40 "
        "deg closed, 0.8 open, 0.3 for a staircase; torque loops: 8]",
        metavar="A | COLUMN=A",
        parse=_parse_amplitudes,
        applies_to=(*_SIGNALS, "torque-loops"),
    )
    offset: float | None = option(
        None, "Centre of the levels. [default: the rig's; one-dof: 0]", applies_to=_SIGNALS
    )
    hold: tuple[float, float] | None = option(
        None,
        "Shortest and longest time at a level in s. [default: the rig's; one-dof: 0.4 1.6; "
        "prbs: 0.1 1, steps: 2 2, staircase: 1 1]",
        metavar="MIN MAX",
        applies_to=("aprbs", "prbs", "steps", "staircase"),
    )
    levels: int | None = option(
        None,
        "Number of equidistant levels, or of heights of a staircase. [default: random levels; "
        "staircase: 8]",
        applies_to=("aprbs", "staircase"),
    )
    rate_limit: float | None = option(
        None,
        "Largest slope in units per s. [default: jumps]",
        applies_to=(*_SIGNALS, "torque-loops"),
    )
    band: tuple[float, float] | None = option(
        None,
        "Lowest and highest frequency in Hz. [default: 0.1 10, or up to a tenth of the sampling "
        "rate]",
        metavar="LOW HIGH",
        applies_to=("multisine", "chirp"),
    )
    sweep: Literal["log", "linear"] | None = option(
        None, "Increase of the frequency of a chirp. [default: log]", applies_to=("chirp",)
    )
    periods: int | None = option(
        None, "Equal periods of a multisine. [default: 2]", applies_to=("multisine",)
    )
    pressure: float | None = option(
        None,
        "Gauge pressure at which muscles are held in torque loops.",
        metavar="KPA",
        applies_to=("torque-loops",),
    )
    muscle: Sequence[str] = option(
        (), "Muscle to pulse, in this order. [default: all]", applies_to=("valve-pulses",)
    )
    level: float = option(1.0, "Duty of the pulses, up to 1.", applies_to=("valve-pulses",))
    release: tuple[float, float] | None = option(
        None,
        "Angles of the release in deg. [default: 30 40]",
        metavar="Q1 Q2",
        applies_to=("gravity-test",),
    )
    clamped: Sequence[str] = option(
        (),
        "Joint that is clamped at its release angle.",
        metavar="JOINT",
        applies_to=("gravity-test",),
    )
    payload: float | None = option(
        None, "Mass on the tip.", metavar="KG", applies_to=("gravity-test",)
    )
    limits: bool = option(
        True,
        "Keep a MuJoCo or URDF model within its joint ranges, speeds and forces, and its bodies "
        "apart: the signals are simulated first, and shifted and reduced if necessary.",
        applies_to=_SIGNALS,
    )
    speed_limit: Mapping[str, float] = option(
        (),
        "For such a model: a joint's speed limit in rad/s or m/s, in addition to those of a URDF.",
        metavar="JOINT=V",
        parse=parse_pairs("Write elbow=2."),
        applies_to=_SIGNALS,
    )
    # valve pulses and gravity tests accept a seed, without using it, for old command lines
    seed: int = seed_option(
        "The same seed gives the same signal.", applies_to=(*SEEDED, "valve-pulses", "gravity-test")
    )
    output: FilePath = option("excitation.csv", "File to write: .csv, .mat, .st or .h.")
    form: Literal["csv", "mat", "mat-file", "mat-matrix", "st", "h"] | None = option(
        None, "Format of the file. [default: by its suffix]", "--format"
    )
    figure: FilePath | None = option(
        None,
        "PNG to draw: coverage of amplitude and frequency.",
        applies_to=(*_SIGNALS, "torque-loops"),
    )
    overwrite: bool = option(False, "Replace the output if it exists.", formerly="--force")

    @property
    def period_s(self) -> float:
        """Sampling period; of arguments with the defaults of their rig."""
        assert self.period is not None
        return self.period
