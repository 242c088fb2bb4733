"""`pamid simulate`: Simulate a virtual rig with any effects and sensor noise."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .hints import unused
from .options import noise_factor, parse_known, rig_words, seed_option
from .terminal import quoted, staged_progress, warning

HELP_ORDER = 20
EXAMPLE = """
pamid simulate --rig one-dof --excitation excitation.csv --effect coulomb-friction:torque_n_m=0.3 --known inertia_kg_m2=0.0896 --seed 2 --output rec.csv
pamid simulate --model fitted --excitation excitation.csv --noise none --output model.csv
"""  # noqa: E501


@frame.command("simulate", example=EXAMPLE)
@click.option(
    "--rig",
    help="Rig by name, or the path of a file: a rig file (it is run), a MuJoCo or URDF model, "
    "or an FMU (its binary is run). "
    "[default: the rig that the excitation names, else one-dof]",
)
@click.option(
    "--model",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="RUN",
    help="Simulate the result of `pamid fit` or `pamid diagnose`, with its integration steps, "
    "instead of a rig from its data sheet. Repeat --rig and --effect for files of that run.",
)
@click.option(
    "--which",
    default="best",
    show_default=True,
    help="With --model, the model to simulate. cause: the model with the causes of a diagnosis; "
    "network: the model that the network was trained on, together with the network; refitted; "
    "best: causes and network if they go together, else the first of these that the run has.",
)
@click.option(
    "--excitation",
    type=click.Path(path_type=Path),
    required=True,
    help="CSV with time_s and the inputs.",
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    help="NAME, NAME@PORT, with :parameter=value,...; or the path of an effect file (it is run).",
)
@click.option(
    "--known",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of the virtual rig that the recording states as known.",
)
@click.option(
    "--set",
    "hidden",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of the virtual rig that the recording does not state.",
)
@click.option(
    "--noise",
    default="default",
    show_default=True,
    help="default | none | FACTOR on the sensor noise.",
)
@seed_option("Same seed, same noise.")
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("simulated.csv"),
    show_default=True,
    help="CSV file to write.",
)
@frame.overwrite_option("Replace the output if it exists.", formerly_force=True)
def command(
    rig: str | None,
    model: Path | None,
    which: str,
    excitation: Path,
    effects: tuple[str, ...],
    known: tuple[str, ...],
    hidden: tuple[str, ...],
    noise: str,
    seed: int,
    output: Path,
    overwrite: bool,
) -> frame.Result:
    """Simulate a virtual rig on an excitation and write the readings of its sensors.

    A reference column drives the rig's controller (closed loop). A command column is replayed (open
    loop). A rig with several joints needs the references of all joints, or all commands. Known
    values in the TOML of the excitation apply to the rig, and the recording states them. The
    recording does not state the effects, the values of --set, or the name of a rig file.
    """
    from pamid.api.simulating import simulate
    from pamid.schemas.command_files import SimulatedFile

    with staged_progress("simulate"):
        simulated = simulate(
            excitation,
            rig,
            effects=effects,
            model=model,
            which=which,
            known=parse_known(known),
            parameters=parse_known(hidden),
            noise=noise_factor(noise),
            seed=seed,
            output=output,
            overwrite=overwrite,
        )
    for text in simulated.warnings:
        warning(text)
    # the output names a rig file, while a recording names only rigs of the catalogue
    ran = rig or simulated.rig
    content = SimulatedFile(
        output=str(output),
        samples=len(simulated),
        rig=ran,
        loop=simulated.loop,
        effects=simulated.effects,
        seed=seed,
    )
    effects_text = ", ".join(simulated.effects) or "no effect"
    text = (
        f"{output}: {len(simulated)} samples of {', '.join(simulated.columns)} "
        f"({effects_text}, seed {seed}).\n"
        f"Next: {_follow(output, len(simulated), ran or 'one-dof')}"
    )
    return frame.Result(content, text)


def _follow(output: Path, samples: int, rig: str) -> str:
    from pamid.simulation.data_split import FEWEST_SAMPLES

    if samples < FEWEST_SAMPLES:
        why = f"(a fit needs {FEWEST_SAMPLES} samples)"
        return f"pamid check {quoted(output)} {rig_words(rig)}   {why}"
    return f"pamid diagnose {quoted(output)} {rig_words(rig)} --output {unused('run')}"
