"""`pamid export`: Write an identified model as FMU, C, ONNX or MATLAB function."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pamid.api.options.names import export_forms
from pamid.api.options.record import (
    AnyPath,
    EffectName,
    RigName,
    argument,
    known_option,
    option,
    overwrite_option,
    required_option,
    which_option,
)

from . import frame
from .terminal import staged_progress, warning

if TYPE_CHECKING:
    from pamid.export.plain_check import PlainCheck

HELP_ORDER = 120
FORMS = export_forms()
EXAMPLE = """
pamid export run --to fmu --output joint.fmu
"""


@dataclass(frozen=True)
class Arguments:
    """Write the model identified in RUN (rig, effects and network, if any) for use in another tool.

    Every form except mjcf and urdf reproduces `pamid simulate --model RUN --noise none` sample by
    sample. Inputs and outputs are the columns of a recording, in their units. An input is constant
    over a sample. mjcf and urdf are the model file of the rig with the identified values. That file
    is run in MuJoCo, and its errors on held-out data are printed next to those of the old file.
    """

    run: AnyPath = argument()
    form: str = required_option(
        "; ".join(
            f"{', also '.join((form, *also))}: {line}" for form, (also, line) in FORMS.items()
        )
        + ".",
        "--to",
        choices=tuple(name for form, (also, _) in FORMS.items() for name in (form, *also)),
    )
    _: KW_ONLY
    output: AnyPath | None = option(
        None, "File to write, for c a folder. [default: pamid_<rig>.<ending>]"
    )
    which: str = which_option("Model to export.")
    known: Mapping[str, float] | None = known_option(
        "Parameter with another known value in that application."
    )
    rig: RigName | None = option(None, "Rig file of the run (it is run), or its model.")
    effects: Sequence[EffectName] = option((), "Effect file of the run (it is run).", "--effect")
    choose: str = option(
        "",
        "Cause to write if the run could not separate several. [default: the most probable]",
        metavar="EFFECT",
    )
    anyway: bool = option(
        False, "Write a model file (mjcf, urdf) even if it is worse in MuJoCo than the original."
    )
    randomise: AnyPath | None = option(
        None,
        "Also write nominal values, standard deviations and covariance of the parameters, as YAML, "
        "for domain randomisation.",
    )
    overwrite: bool = overwrite_option("Replace what exists.", formerly="--force")


@frame.command("export", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.base.schemas.command_files import WrittenExport
    from pamid.export.exporting import export_model
    from pamid.networks.correction.identified_model import load_identified

    a = arguments
    with staged_progress("export") as progress:
        progress.say("reading")
        identified = load_identified(
            Path(a.run), which=a.which, rig=a.rig, effects=tuple(a.effects), choose=a.choose
        )
        model = identified.knowing(a.known or {})
        exported = export_model(
            model,
            a.form,
            None if a.output is None else Path(a.output),
            overwrite=a.overwrite,
            anyway=a.anyway,
            randomise=None if a.randomise is None else Path(a.randomise),
        )
    network, files = model.network, tuple(map(str, exported.files))
    for note in exported.notes:
        warning(f"{files[0]}: {note}.")
    effects = tuple(a.label for a in model.effects)
    written = WrittenExport(
        to=a.form,
        files=files,
        binary=exported.binary,
        rig=model.name,
        effects=effects,
        network="" if network is None else network.trained.network.kind,
        period_s=model.period_s,
        inputs=model.inputs,
        outputs=model.outputs,
        notes=exported.notes,
    )
    if exported.check is not None:
        written = written.model_copy(update={"plain_mujoco": exported.check.errors})
    built = f", with a binary for {exported.binary}" if exported.binary else ""
    text = (
        f"{', '.join(files)}: {model.name} with "
        f"{', '.join(effects) or 'no effect'}"
        f"{'' if network is None else f' and a network ({written.network})'}{built}.\n"
        f"Every {model.period_s:g} s: {', '.join(model.inputs)} -> {', '.join(model.outputs)}"
    )
    if exported.check is not None:
        text += f"\n{_plain_text(exported.check)}"
    return frame.Result(written, text)


def _plain_text(check: PlainCheck) -> str:
    """Errors of the old and the new file by channel, then the step that reaches the stated ones."""
    lines = [f"Mean absolute error on held-out data, in plain MuJoCo ({check.settings}):"]
    channels, reached = check.errors.channels, check.errors.reached
    for name, c in channels.items():
        stated = "" if c.stated is None else f"; the run predicts {c.stated:.4g}"
        lines.append(f"  {name}: {c.before:.4g} with the old file, {c.now:.4g} now{stated}")
    if check.best == check.settings:
        if reached is False:
            lines.append("No other step or integrator is better.")
        return "\n".join(lines)
    errors = ", ".join(f"{name} {c.best:.4g}" for name, c in channels.items())
    words = "reaches the predicted error" if reached else "is closest to the predicted error"
    lines.append(
        f"{check.best.integrator} with {1e3 * check.best.timestep_s:g} ms {words} ({errors}): "
        f"{check.best.option}"
    )
    return "\n".join(lines)
