"""`pamid generate-aprbs`: an excitation file and what it covers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from . import frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

EXAMPLE = """
pamid generate-aprbs --rig one-dof --duration 200 --amplitude 40 --hold 0.4 1.6 --seed 1 --output excitation.csv
pamid generate-aprbs --experiment gravity-test --rig two-link --release 60 0 --clamped 1 --output gravity.csv
"""
#: options that only some experiments take
_TAKEN_BY = {
    **dict.fromkeys(("loop", "column", "amplitude", "offset", "hold", "levels", "rate_limit"), ("aprbs",)),
    "duration": ("aprbs", "gravity-test"), **dict.fromkeys(("release", "clamped", "payload"), ("gravity-test",)),
    **dict.fromkeys(("muscle", "level"), ("valve-pulses",)),
}


@frame.command("generate-aprbs", example=EXAMPLE)
@click.option("--experiment", type=click.Choice(["aprbs", "valve-pulses", "gravity-test"]), default="aprbs",
              show_default=True, help="Random steps, pulses on the valves, or a swing with the muscles vented.")
@click.option("--rig", default="one-dof", show_default=True, help="Rig to excite.")
@click.option("--loop", type=click.Choice(["closed", "open"]), default="closed", show_default=True,
              help="Excite the references of the controllers, or the commands themselves.")
@click.option("--column", help="Name of the column, for a rig of your own (e.g. force_n).")
@click.option("--duration", type=float, help="Length in s. [default: 200; 20 of a gravity test]")
@click.option("--period", type=float, default=0.003, show_default=True, help="Sampling period in s.")
@click.option("--amplitude", multiple=True, metavar="A | COLUMN=A",
              help="Levels lie within +- this, in the unit of the column. [default: the rig's; one-dof: 40 deg closed, "
              "0.8 open]")
@click.option("--offset", type=float, default=0.0, show_default=True, help="Centre of the levels.")
@click.option("--hold", type=float, nargs=2, default=(0.4, 1.6), show_default=True,
              help="Shortest and longest time at one level in s.")
@click.option("--levels", type=int, help="Number of equidistant levels. [default: every hold its own]")
@click.option("--rate-limit", type=float, help="Largest slope in units per s. [default: jumps]")
@click.option("--muscle", multiple=True, help="Muscle to pulse, in this order. [default: all]")
@click.option("--level", type=float, default=1.0, show_default=True, help="Duty of the pulses, up to 1.")
@click.option("--release", type=float, nargs=2, metavar="Q1 Q2", help="Angles to let go from in deg. [default: 30 40]")
@click.option("--clamped", multiple=True, metavar="JOINT", help="Joint that is clamped where it is released.")
@click.option("--payload", type=float, metavar="KG", help="Mass on the tip.")
@click.option("--seed", type=int, default=0, show_default=True, help="Same seed, same signal.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), required=True, help="CSV file to write.")
@click.option("--force", is_flag=True, help="Replace the output if it exists.")
def command(output: Path, force: bool, **request: Any) -> frame.Result:
    """Make an amplitude-modulated pseudo-random step signal (APRBS) for a rig, or another experiment.

    aprbs: independent random steps on the reference of every joint, or on every command. Prints how well they cover
    amplitude and frequency, and what they cannot excite.
    valve-pulses: 30 to 500 ms past the controller, every 1.5 s, venting and filling muscle after muscle.
    gravity-test: nothing is sent; the rig swings from where it is released, its muscles vented.

    Writes a CSV (time_s and the columns to send), beside it a JSON file with what they are and their sha256 and, for
    the last two, a TOML file with what the rig has to be set to. `pamid simulate` reads both.
    """
    from pamid.errors import FileError

    _refuse_strangers(request["experiment"])
    note, sidecar = output.with_suffix(".json"), output.with_suffix(".toml")
    if output in (note, sidecar):
        raise FileError(f"{output}: an excitation is a CSV file.", f"Write --output {output.with_suffix('.csv')}.")
    made = {"aprbs": _aprbs, "valve-pulses": _pulses, "gravity-test": _gravity}[request["experiment"]](request)
    for path in (output, note, *([sidecar] if made.meta else [])):
        if path.exists() and not force:
            raise FileError(f"{path} exists already.", "Choose another --output, or --force to replace it.",
                            code="exists")
    return _write(output, note, made, request)


@dataclass(frozen=True)
class _Made:
    """Columns to send, the tables of the TOML beside them, what to note of them, and what to say."""

    columns: dict[str, NDArray[Any]]
    about: dict[str, Any]
    said: list[str]
    meta: dict[str, Any] = field(default_factory=dict)


def _refuse_strangers(experiment: str) -> None:
    from pamid.errors import UsageError

    context = click.get_current_context()
    for name, takers in _TAKEN_BY.items():
        if experiment not in takers and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise UsageError(f"--{name.replace('_', '-')} says nothing to --experiment {experiment}.",
                             f"It belongs to {' and '.join(takers)}.")


# ---- random steps ------------------------------------------------------------------------------------------------


def _aprbs(request: dict[str, Any]) -> _Made:
    from pamid.excitation import aprbs, coverage
    from pamid.units import split_column

    period, offset, seed = request["period"], request["offset"], request["seed"]
    duration = 200.0 if request["duration"] is None else request["duration"]
    columns, each, said = {}, [], []
    amplitudes = _amplitudes(request)
    for k, (column, amplitude) in enumerate(amplitudes.items()):
        own = [seed, k] if k else seed  # the first column is what it would be alone
        signal = aprbs(duration, period, amplitude, request["hold"], request["levels"], request["rate_limit"], own,
                       offset)
        covers = coverage(signal, period, span=(offset - amplitude, offset + amplitude))
        columns[column] = signal
        each.append({
            "column": column, "unit": split_column(column)[1], "range": [offset - amplitude, offset + amplitude],
            "seed": own,
            "coverage": {"evenness": covers.evenness, "visited": covers.visited, "steps": covers.steps,
                         "shortest_hold_s": covers.shortest_hold_s, "longest_hold_s": covers.longest_hold_s,
                         "power_95_hz": covers.power_95_hz, "band_20db_hz": covers.band_20db_hz,
                         "histogram": covers.histogram, "sentences": covers.sentences()},
        })  # fmt: skip
        said += [f"  {column}:"] if len(amplitudes) > 1 else []
        said += [f"  {sentence}" for sentence in covers.sentences()]
    alone = each[0] if len(each) == 1 else {}
    about = {"loop": request["loop"], **{key: alone[key] for key in ("column", "unit", "range") if alone},
             **({} if alone else {"columns": each}), "hold_s": list(request["hold"]), "levels": request["levels"],
             "rate_limit_per_s": request["rate_limit"], "seed": seed, **_clock(request, columns),
             **{key: alone[key] for key in ("coverage",) if alone}}
    return _Made(columns, about, said)


def _amplitudes(request: dict[str, Any]) -> dict[str, float]:
    """The columns to write and their amplitudes."""
    from pamid.errors import UsageError, nearest
    from pamid.experiments import excitable
    from pamid.library import rig_named

    given = _given(request["amplitude"])
    columns, usual, most = [request["column"]], {}, math.inf
    if request["column"] is None:
        rig = rig_named(request["rig"])
        columns, usual = list(excitable(rig, request["loop"])), rig.excited
        if rig.loops and request["loop"] == "open":
            most = rig.controller.get("command_limit", math.inf)
    for name in given:
        if name and name not in columns:
            raise UsageError(f"--amplitude {name}: the columns are {', '.join(columns)}.", nearest(name, columns))
    found = {}
    for name in columns:
        amplitude = given.get(name, given.get("", usual.get(name)))
        if amplitude is None:
            raise UsageError(f"{name} needs an --amplitude.", f"For example --amplitude {name}=1.")
        reach = amplitude + abs(request["offset"])
        if reach > most:
            raise UsageError(f"{name} lies within +-{most:g}; amplitude and offset reach {reach:g}.")
        found[name] = amplitude
    return found


def _given(texts: tuple[str, ...]) -> dict[str, float]:
    """("20", "reference_2_deg=30") as a table; "" stands for every column."""
    from pamid.errors import UsageError

    found = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            raise UsageError(f"--amplitude {text!r} is no number.", "Write 20, or reference_2_deg=30.") from None
    return found


# ---- tests of the muscles and of the links -----------------------------------------------------------------------


def _pulses(request: dict[str, Any]) -> _Made:
    from pamid.errors import UsageError
    from pamid.experiments import PULSES_S, muscle_pulses
    from pamid.library import rig_named

    rig = rig_named(request["rig"])
    if not 0.0 < request["period"] <= PULSES_S[0]:
        raise UsageError(f"The period is {request['period']:g} s; the shortest pulse lasts {PULSES_S[0]:g} s.")
    columns = muscle_pulses(rig, request["muscle"], request["level"], request["period"])
    pulsed = list(request["muscle"] or rig.filled_by)
    lengths = ", ".join(f"{1e3 * s:g}" for s in PULSES_S)
    said = [f"  Muscle {' then '.join(pulsed)}: vented and filled again for {lengths} ms at a duty of "
            f"{request['level']:g}.", f"  A fit would hold out the last 30 %, with muscle {pulsed[-1]}: record "
            "another order for --held-out."]
    return _Made(columns, _about(request, columns, {"muscles": pulsed, "level": request["level"]}), said,
                 _meta(request, {}))


def _gravity(request: dict[str, Any]) -> _Made:
    from pamid.errors import UsageError
    from pamid.experiments import RELEASE_DEG, RELEASE_S, gravity_test, nothing_sent
    from pamid.library import rig_named

    rig = rig_named(request["rig"])
    known = gravity_test(rig, request["release"] or RELEASE_DEG, request["clamped"], request["payload"])
    seconds = RELEASE_S if request["duration"] is None else request["duration"]
    if not 0.0 < request["period"] < seconds < math.inf:
        raise UsageError(f"{seconds:g} s sampled every {request['period']:g} s are no recording.")
    columns = nothing_sent(rig, round(seconds / request["period"]))
    said = ["  Nothing is sent: " + ", ".join(f"{name} = {value:g}" for name, value in known.items()) + ".",
            "  Cannot show: valves, and what of the muscles grows with their pressure.",
            "  A fit would hold out the last 30 %, the end of the swing: record another release for --held-out."]
    return _Made(columns, _about(request, columns, {"known": known}), said, _meta(request, known))


def _about(request: dict[str, Any], columns: dict[str, NDArray[Any]], own: dict[str, Any]) -> dict[str, Any]:
    from pamid.units import split_column

    ranges = [{"column": name, "unit": split_column(name)[1], "range": [float(v.min()), float(v.max())]}
              for name, v in columns.items()]
    return {"experiment": request["experiment"], "loop": "open", "columns": ranges, **own, **_clock(request, columns)}


def _meta(request: dict[str, Any], known: dict[str, float]) -> dict[str, Any]:
    return {"recording": {"rig": request["rig"], "loop": "open", "sampling_period_s": request["period"]},
            **({"known": known} if known else {})}


# ---- writing -----------------------------------------------------------------------------------------------------


def _clock(request: dict[str, Any], columns: dict[str, NDArray[Any]]) -> dict[str, Any]:
    return {"sampling_period_s": request["period"], "samples": len(next(iter(columns.values())))}


def _write(output: Path, note: Path, made: _Made, request: dict[str, Any]) -> frame.Result:
    from importlib.metadata import version

    import numpy as np

    from pamid.recording import write_recording
    from pamid.run import sha256_of, write_json

    period, samples = request["period"], made.about["samples"]
    output.parent.mkdir(parents=True, exist_ok=True)
    write_recording(output, period * np.arange(samples), made.columns, made.meta)
    about = {"schema": "pamid.excitation/1", "generator": f"pamid {version('pamid')} generate-aprbs",
             "file": output.name, "sha256": sha256_of(output), "rig": request["rig"], **made.about}
    write_json(note, about)
    seed = f", seed {request['seed']}" if "seed" in about else ""
    first = f"{output}: {samples} samples of {', '.join(made.columns)} at {period:g} s{seed}."
    follow = f"pamid simulate --rig {request['rig']} --excitation {output} --output rec.csv"
    return frame.Result(about, "\n".join([first, *made.said, f"Next: {follow}"]))
