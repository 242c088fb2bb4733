"""`pamid export`: Write an identified model as FMU, C, ONNX or MATLAB function."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame, names
from .options import parse_known
from .terminal import aside, told_progress

PLACE = 120
FORMS = names.export_forms()
EXAMPLE = """
pamid export run --to fmu --output joint.fmu
"""


@frame.command("export", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "form",
    type=click.Choice([name for own, (also, _) in FORMS.items() for name in (own, *also)]),
    required=True,
    help="; ".join(f"{', also '.join((own, *also))}: {line}" for own, (also, line) in FORMS.items())
    + ".",
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    help="File to write, for c a folder. [default: pamid_<rig>.<ending>]",
)
@click.option(
    "--which",
    default="best",
    show_default=True,
    help="cause (of a diagnosis), network (the model that the network of the run was trained on, "
    "with it: the refitted one, or after train-residual --on causes the one with the causes), "
    "refitted, or best: causes and network where both go together, else the first of these there "
    "is.",
)
@click.option(
    "--known",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter that is known to be otherwise there.",
)
@click.option("--rig", help="The rig file that the run was made with (it is run), or its model.")
@click.option(
    "--effect",
    "effects",
    multiple=True,
    help="An effect file that the run was made with (it is run).",
)
@frame.overwrite_option("Replace what exists.", formerly_force=True)
def command(
    run: Path,
    form: str,
    output: Path | None,
    which: str,
    known: tuple[str, ...],
    rig: str | None,
    effects: tuple[str, ...],
    overwrite: bool,
) -> frame.Result:
    """Write the model that RUN found (rig, effects and a network, if there is one) for use in
    another tool.

    Every form but mjcf gives, sample by sample, what `pamid simulate --model RUN --noise none`
    gives. Inputs and outputs are the columns of a recording, in their units; an input holds over
    the sample. mjcf is the model file of the rig with the values of the run; what it cannot hold is
    told.
    """
    from pamid.correction.identified_model import load_identified
    from pamid.export.exporting import export_model
    from pamid.schemas.command_files import WrittenExport

    with told_progress("export") as progress:
        progress.say("reading")
        found = load_identified(run, which=which, rig=rig, effects=effects)
        model = found.knowing(parse_known(known))
        made = export_model(model, form, output, overwrite=overwrite)
    step, network = made.step, model.network
    for note in made.notes:
        aside(f"Warning: {made.files[0]}: {note}.")
    effects = tuple(a.label for a in model.effects)
    inputs, outputs = (tuple(v.name for v in vs) for vs in (step.inputs, step.outputs))
    written = WrittenExport(
        to=form,
        files=tuple(map(str, made.files)),
        binary=made.binary,
        rig=model.name,
        effects=effects,
        network="" if network is None else network.trained.network.kind,
        period_s=step.period_s,
        inputs=inputs,
        outputs=outputs,
        notes=made.notes,
    )
    built = f", with a binary for {made.binary}" if made.binary else ""
    text = (
        f"{', '.join(map(str, made.files))}: {model.name} with "
        f"{', '.join(effects) or 'no effect'}"
        f"{'' if network is None else f' and a network ({written.network})'}{built}.\n"
        f"Every {step.period_s:g} s: {', '.join(inputs)} -> {', '.join(outputs)}"
    )
    return frame.Result(written, text)
