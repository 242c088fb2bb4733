"""`pamid generate-aprbs`: Generate an excitation of many kinds (also called `pamid excite`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame
from .excite import PlannedExcitation, make, refuse_other_options, with_rig_defaults
from .hints import unused, why_not_driven
from .options import figure_option, require_png_name, rig_words, seed_option
from .terminal import quoted

HELP_ORDER = 10
EXAMPLE = """
pamid generate-aprbs --rig one-dof --duration 200 --amplitude 40 --hold 0.4 1.6 --seed 1 --output excitation.csv
pamid generate-aprbs --experiment gravity-test --rig two-link --release 60 0 --clamped 1 --output gravity.csv
pamid generate-aprbs --signal multisine --loop open --amplitude 0.5 --band 0.1 5 --duration 60 --output sines.mat
"""  # noqa: E501
FORMAT_NAMES = ("csv", "mat", "mat-file", "mat-matrix", "st", "h")


@frame.command("generate-aprbs", example=EXAMPLE)
@click.option(
    "--experiment",
    type=click.Choice(["aprbs", "valve-pulses", "gravity-test"]),
    default="aprbs",
    show_default=True,
    help="A signal (--signal), pulses on the valves, or a swing with the muscles vented.",
)
@click.option(
    "--signal",
    type=click.Choice(
        ["aprbs", "prbs", "multisine", "chirp", "steps", "staircase", "torque-loops"]
    ),
    default="aprbs",
    show_default=True,
    help="Kind of signal; see below.",
)
@click.option("--rig", default="one-dof", show_default=True, help="Rig to excite.")
@click.option(
    "--loop",
    type=click.Choice(["closed", "open"]),
    default="closed",
    show_default=True,
    help="Excite the references of the controllers, or the commands themselves.",
)
@click.option(
    "--column", help="Name of the column, for a rig outside the catalogue (e.g. force_n)."
)
@click.option(
    "--duration",
    type=float,
    help="Length in s. [default: 200, or 125 of the rig's longest holds; gravity test: 20; torque "
    "loops: one pass]",
)
@click.option(
    "--period", type=float, help="Sampling period in s. [default: the rig's; one-dof: 0.003]"
)
@click.option(
    "--amplitude",
    multiple=True,
    metavar="A | COLUMN=A",
    help="Levels lie within +- this, in the unit of the column. [default: the rig's; one-dof: 40 "
    "deg closed, 0.8 open, 0.3 for a staircase; torque loops: 8]",
)
@click.option("--offset", type=float, help="Centre of the levels. [default: the rig's; one-dof: 0]")
@click.option(
    "--hold",
    type=float,
    nargs=2,
    metavar="MIN MAX",
    help="Shortest and longest time at one level in s. [default: the rig's; one-dof: 0.4 1.6; "
    "prbs: 0.1 1, steps: 2 2, staircase: 1 1]",
)
@click.option(
    "--levels",
    type=int,
    help="Number of equidistant levels, or of heights of a staircase. [default: random levels; "
    "staircase: 8]",
)
@click.option("--rate-limit", type=float, help="Largest slope in units per s. [default: jumps]")
@click.option(
    "--band",
    type=float,
    nargs=2,
    metavar="LOW HIGH",
    help="Lowest and highest frequency in Hz. [default: 0.1 10, or up to a tenth of the sampling "
    "rate]",
)
@click.option(
    "--sweep", type=click.Choice(["log", "linear"]), help="How a chirp climbs. [default: log]"
)
@click.option("--periods", type=int, help="Equal periods of a multisine. [default: 2]")
@click.option(
    "--pressure",
    type=float,
    metavar="KPA",
    help="Gauge pressure at which muscles are held in torque loops.",
)
@click.option("--muscle", multiple=True, help="Muscle to pulse, in this order. [default: all]")
@click.option(
    "--level", type=float, default=1.0, show_default=True, help="Duty of the pulses, up to 1."
)
@click.option(
    "--release",
    type=float,
    nargs=2,
    metavar="Q1 Q2",
    help="Angles of the release in deg. [default: 30 40]",
)
@click.option(
    "--clamped", multiple=True, metavar="JOINT", help="Joint that is clamped at its release angle."
)
@click.option("--payload", type=float, metavar="KG", help="Mass on the tip.")
@click.option(
    "--limits/--no-limits",
    default=True,
    show_default=True,
    help="Keep a MuJoCo or URDF model within its joint ranges, speeds and forces, and its bodies "
    "apart: the signals are simulated first, and shifted and reduced if necessary.",
)
@click.option(
    "--speed-limit",
    multiple=True,
    metavar="JOINT=V",
    help="For such a model: a joint's speed limit in rad/s or m/s, in addition to those of a URDF.",
)
@seed_option("Same seed, same signal.")
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("excitation.csv"),
    show_default=True,
    help="File to write: .csv, .mat, .st or .h.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMAT_NAMES),
    help="Format of the file. [default: by its suffix]",
)
@figure_option("coverage of amplitude and frequency")
@frame.overwrite_option("Replace the output if it exists.", formerly_force=True)
def command(
    output: Path, form: str | None, figure: Path | None, overwrite: bool, **request: Any
) -> frame.Result:
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

    Random signals excite all joints together, other signals one joint after the other. Prints how
    well they cover amplitude and frequency, and what they cannot excite.

    valve-pulses: pulses of 30 to 500 ms that bypass the controller, every 1.5 s, to vent and fill
    one muscle after the other. gravity-test: no command; the rig swings after its release, with
    vented muscles.

    Writes a CSV (time_s and the columns to send), or what Simulink, a PLC or a C program plays: mat
    and mat-matrix for From Workspace, mat-file for From File, st with change points, h with samples
    and change points. Beside it a JSON file with what they are and their sha256 and, where the rig
    has to be set to something, a TOML file with it. `pamid simulate` reads CSV and TOML.
    """
    from pamid.base.errors import FileError
    from pamid.base.files import require_new
    from pamid.excitation.writers import format_of

    refuse_other_options(request["experiment"], request["signal"])
    note, sidecar = output.with_suffix(".json"), output.with_suffix(".toml")
    if output in (note, sidecar):
        raise FileError(
            f"{output}: an excitation is a CSV file.",
            f"Write --output {quoted(output.with_suffix('.csv'))}.",
        )
    form = format_of(output, form)
    require_png_name(figure)
    request = with_rig_defaults(request)
    planned = make(request)
    require_new(
        (output, note, *([sidecar] if planned.meta else []), *([figure] if figure else [])),
        overwrite,
    )
    return _write(output, form, figure, planned, request)


def _write(
    output: Path,
    form: str,
    figure: Path | None,
    planned: PlannedExcitation,
    request: dict[str, Any],
) -> frame.Result:
    from pamid.excitation.writers import FORMATS, write_excitation

    period, samples = request["period"], planned.about["samples"]
    follow = _simulated(output, planned, request["rig"]) if form == "csv" else FORMATS[form].heed
    pictures = {}
    if figure is not None:
        from pamid.base.files import make_folder
        from pamid.report.excitation_figure import ExcitedColumn, richness_picture

        pictures[figure] = richness_picture(
            [ExcitedColumn(period_s=period, **column) for column in planned.shown]
        ).png
        make_folder(figure.parent)
    about = write_excitation(
        output,
        planned.columns,
        period,
        {"rig": request["rig"], **planned.about},
        form=form,
        meta=planned.meta,
        others=pictures,
    )
    seed = f", seed {request['seed']}" if "seed" in about else ""
    first = f"{output}: {samples} samples of {', '.join(planned.columns)} at {period:g} s{seed}."
    sidecar = output.with_suffix(".toml")
    left = [f"  {sidecar} exists and is not changed. Its entries apply to this excitation as well."]
    lines = [
        first,
        *planned.sentences,
        *([f"  Picture: {figure}."] if figure else []),
        *(left if sidecar.exists() and not planned.meta else []),
    ]
    return frame.Result(about, "\n".join([*lines, f"Next: {follow}"]))


def _simulated(output: Path, planned: PlannedExcitation, rig: str) -> str:
    why = why_not_driven(rig, output, planned.columns)
    if why:
        return f"send it to your rig. To simulate it, give a suitable rig with --rig: {why}."
    return (
        f"pamid simulate {rig_words(rig)} --excitation {quoted(output)} "
        f"--output {quoted(unused('rec.csv', [output]))}"
    )
