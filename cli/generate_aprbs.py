"""`pamid generate-aprbs`: an excitation file and what it covers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from . import frame

#: rig -> loop -> (column, default amplitude, largest amplitude)
_COLUMNS = {"one-dof": {"closed": ("reference_deg", 40.0, math.inf), "open": ("command", 0.8, 1.0)}}

EXAMPLE = """
pamid generate-aprbs --rig one-dof --duration 200 --amplitude 40 --hold 0.4 1.6 --seed 1 --output excitation.csv
"""


@frame.command("generate-aprbs", example=EXAMPLE)
@click.option("--rig", default="one-dof", show_default=True, help="Rig to excite.")
@click.option("--loop", type=click.Choice(["closed", "open"]), default="closed", show_default=True,
              help="Excite the reference of the controller, or the command itself.")
@click.option("--column", help="Name of the column, for a rig of your own (e.g. force_n).")
@click.option("--duration", type=float, default=200.0, show_default=True, help="Length in s.")
@click.option("--period", type=float, default=0.003, show_default=True, help="Sampling period in s.")
@click.option("--amplitude", type=float, help="Levels lie within +- this, in the unit of the column. "
              "[default: 40 deg closed, 0.8 open]")
@click.option("--offset", type=float, default=0.0, show_default=True, help="Centre of the levels.")
@click.option("--hold", type=float, nargs=2, default=(0.4, 1.6), show_default=True,
              help="Shortest and longest time at one level in s.")
@click.option("--levels", type=int, help="Number of equidistant levels. [default: every hold its own]")
@click.option("--rate-limit", type=float, help="Largest slope in units per s. [default: jumps]")
@click.option("--seed", type=int, default=0, show_default=True, help="Same seed, same signal.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), required=True, help="CSV file to write.")
@click.option("--force", is_flag=True, help="Replace the output if it exists.")
def command(output: Path, force: bool, **request: Any) -> frame.Result:
    """Make an amplitude-modulated pseudo-random step signal for a rig.

    Writes a CSV (time_s and one column) and, beside it, a JSON file with seed, range, unit and sha256. Prints how well
    the signal covers amplitude and frequency, and what it cannot excite.
    """
    from pamid.errors import FileError

    note = output.with_suffix(".json")
    for path in (output, note):
        if path.exists() and not force:
            raise FileError(f"{path} exists already.", "Choose another --output, or --force to replace it.",
                            code="exists")
    if note == output:
        raise FileError(f"{output}: an excitation is a CSV file.", f"Write --output {output.with_suffix('.csv')}.")
    return _write(output, note, *_column_of(request), request)


def _column_of(request: dict[str, Any]) -> tuple[str, float]:
    """The column to write and its amplitude."""
    from pamid.errors import UsageError

    rig, loop, column = request["rig"], request["loop"], request["column"]
    if column is not None:
        if request["amplitude"] is None:
            raise UsageError("--column needs an --amplitude.")
        return column, request["amplitude"]
    if rig not in _COLUMNS:
        column = _column_of_rig(rig, request["loop"])
        if request["amplitude"] is None:
            raise UsageError(f"--rig {rig} needs an --amplitude for {column}.")
        return column, request["amplitude"]
    name, usual, most = _COLUMNS[rig][loop]
    amplitude = usual if request["amplitude"] is None else request["amplitude"]
    if amplitude + abs(request["offset"]) > most:
        raise UsageError(f"{name} lies within +-{most:g}; amplitude and offset reach "
                         f"{amplitude + abs(request['offset']):g}.")
    return name, amplitude


def _column_of_rig(name: str, loop: str) -> str:
    """What a rig takes: the reference of its controller, or its first input."""
    from pamid.library import rig_named

    rig = rig_named(name)
    if loop == "closed" and rig.loops:
        return rig.loops[0].reference
    return next(column for column in rig.inputs if column not in rig.optional)


def _write(output: Path, note: Path, column: str, amplitude: float, request: dict[str, Any]) -> frame.Result:
    from importlib.metadata import version

    import numpy as np

    from pamid.excitation import aprbs, coverage
    from pamid.recording import write_recording
    from pamid.run import sha256_of, write_json
    from pamid.units import split_column

    period, offset = request["period"], request["offset"]
    signal = aprbs(request["duration"], period, amplitude, request["hold"], request["levels"], request["rate_limit"],
                   request["seed"], offset)
    covers = coverage(signal, period, span=(offset - amplitude, offset + amplitude))
    output.parent.mkdir(parents=True, exist_ok=True)
    write_recording(output, period * np.arange(signal.size), {column: signal})
    about = {
        "schema": "pamid.excitation/1",
        "generator": f"pamid {version('pamid')} generate-aprbs",
        "file": output.name,
        "sha256": sha256_of(output),
        "rig": request["rig"],
        "loop": request["loop"],
        "column": column,
        "unit": split_column(column)[1],
        "range": [offset - amplitude, offset + amplitude],
        "hold_s": list(request["hold"]),
        "levels": request["levels"],
        "rate_limit_per_s": request["rate_limit"],
        "seed": request["seed"],
        "sampling_period_s": period,
        "samples": int(signal.size),
        "coverage": {"evenness": covers.evenness, "visited": covers.visited, "steps": covers.steps,
                     "shortest_hold_s": covers.shortest_hold_s, "longest_hold_s": covers.longest_hold_s,
                     "power_95_hz": covers.power_95_hz, "band_20db_hz": covers.band_20db_hz,
                     "histogram": covers.histogram, "sentences": covers.sentences()},
    }  # fmt: skip
    write_json(note, about)
    lines = [f"{output}: {signal.size} samples of {column} at {period:g} s, seed {request['seed']}."]
    lines += [f"  {sentence}" for sentence in covers.sentences()]
    follow = f"pamid simulate --rig {request['rig']} --excitation {output} --output rec.csv"
    return frame.Result(about, "\n".join([*lines, f"Next: {follow}"]))
