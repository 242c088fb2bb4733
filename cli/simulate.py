"""`pamid simulate`: Simulate a virtual rig with any effects and sensor noise."""

from __future__ import annotations

from pathlib import Path

from pamid.api.options.simulating import SimulationArguments
from pamid.base.errors import quoted

from . import frame
from .hints import rig_words, unused
from .terminal import staged_progress, warning

HELP_ORDER = 20
EXAMPLE = """
pamid simulate --rig one-dof --excitation excitation.csv --effect coulomb-friction:torque_n_m=0.3 --known inertia_kg_m2=0.0896 --seed 2 --output rec.csv
pamid simulate --model fitted --excitation excitation.csv --noise none --output model.csv
"""  # noqa: E501


@frame.command("simulate", SimulationArguments, example=EXAMPLE)
def command(arguments: SimulationArguments) -> frame.Result:
    from pamid.api.simulating import simulate
    from pamid.base.schemas.command_files import SimulatedFile

    with staged_progress("simulate"):
        simulated = simulate.of(arguments)
    for text in simulated.warnings:
        warning(text)
    # the output names a rig file, while a recording names only rigs of the catalogue
    rig = str(arguments.rig) if arguments.rig else simulated.rig
    content = SimulatedFile(
        output=str(arguments.output),
        samples=len(simulated),
        rig=rig,
        loop=simulated.loop,
        effects=simulated.effects,
        seed=arguments.seed,
    )
    effects = ", ".join(simulated.effects) or "no effect"
    text = (
        f"{arguments.output}: {len(simulated)} samples of {', '.join(simulated.columns)} "
        f"({effects}, seed {arguments.seed}).\n"
        f"Next: {_follow(simulated.path, len(simulated), rig or 'one-dof')}"
    )
    return frame.Result(content, text)


def _follow(output: Path, samples: int, rig: str) -> str:
    from pamid.simulation.data_split import FEWEST_SAMPLES

    if samples < FEWEST_SAMPLES:
        why = f"(a fit needs {FEWEST_SAMPLES} samples)"
        return f"pamid check {quoted(output)} {rig_words(rig)}   {why}"
    return f"pamid diagnose {quoted(output)} {rig_words(rig)} --output {unused('run')}"
