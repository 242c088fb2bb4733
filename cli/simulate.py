"""`pamid simulate`: a virtual rig with any effects and sensor noise."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .options import noise_factor, parse_known

EXAMPLE = """
pamid simulate --rig one-dof --excitation excitation.csv --effect coulomb-friction:torque_n_m=0.3 --known inertia_kg_m2=0.0896 --seed 2 --output rec.csv
"""  # noqa: E501


@frame.command("simulate", example=EXAMPLE)
@click.option("--rig", help="Rig by name, or the path of a rig file (it is run). "
              "[default: the one the excitation names, else one-dof]")
@click.option("--excitation", type=click.Path(path_type=Path), required=True, help="CSV with time_s and what is sent.")
@click.option("--effect", "effects", multiple=True,
              help="NAME, NAME@PORT, with :parameter=value,...; or the path of an effect file (it is run).")
@click.option("--known", multiple=True, metavar="NAME=VALUE", help="Parameter that the recording will state as known.")
@click.option("--set", "hidden", multiple=True, metavar="NAME=VALUE", help="Parameter of the virtual rig, not stated.")
@click.option("--noise", default="default", show_default=True, help="default | none | FACTOR on the sensor noise.")
@click.option("--seed", type=int, default=0, show_default=True, help="Same seed, same noise.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), required=True, help="CSV file to write.")
@click.option("--force", is_flag=True, help="Replace the output if it exists.")
def command(rig: str | None, excitation: Path, effects: tuple[str, ...], known: tuple[str, ...],
            hidden: tuple[str, ...], noise: str, seed: int, output: Path, force: bool) -> frame.Result:
    """Run a virtual rig on an excitation and write what its sensors would have recorded.

    A reference column runs the rig's controller (closed loop), a command column is replayed (open loop); a rig of
    several joints takes the references of all of them, or all commands. What the excitation's TOML states as known
    holds for the rig, and is stated in the recording.
    """
    from pamid.errors import FileError
    from pamid.library import rig_of
    from pamid.recording import read_recording, write_recording
    from pamid.virtual import virtual_rig

    if output.exists() and not force:
        raise FileError(f"{output} exists already.", "Choose another --output, or --force to replace it.",
                        code="exists")
    source = read_recording(excitation)
    rig = rig or rig_of([source])
    made = virtual_rig(rig, source, effects, parse_known(known), parse_known(hidden), noise_factor(noise), seed)
    output.parent.mkdir(parents=True, exist_ok=True)
    write_recording(output, source.time, made.columns, made.meta)
    found = {"schema": "pamid.simulate/1", "output": str(output), "samples": len(source), "rig": rig,
             "loop": made.meta["recording"]["loop"], "effects": made.effects, "seed": seed}
    told = ", ".join(made.effects) or "no effect"
    text = (f"{output}: {len(source)} samples of {', '.join(made.columns)} ({told}, seed {seed}).\n"
            f"Next: pamid diagnose {output} --rig {rig} --output run")
    return frame.Result(found, text)
