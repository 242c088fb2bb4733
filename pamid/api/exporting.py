"""`pamid.export`: an identified model as files for another tool."""

from __future__ import annotations

from pathlib import Path

from pamid.api.given import effects_given, warn_in_python
from pamid.api.options.exporting import ExportArguments
from pamid.api.options.record import verb
from pamid.api.workers import OpenedRun
from pamid.base.progress import tell
from pamid.base.schemas.command_files import WrittenExport
from pamid.exports.exporting import export_model
from pamid.exports.plain_check import settings_words
from pamid.model.registry import resolved_rig
from pamid.networks.correction.identified_model import load_identified


class ExportResult(WrittenExport):
    """Files of an exported model.

    files: their paths; binary: platform of an FMU's binary, "" for none; inputs, outputs: columns;
    period_s: step of the model in s; plain_mujoco: errors of a model file in MuJoCo on held-out
    data, by channel, before and now.
    """

    to_dict = WrittenExport.as_json

    def summary(self) -> str:
        """Files, effects, columns and, for a model file, its errors, as lines of text."""
        built = f", with a binary for {self.binary}" if self.binary else ""
        network = f" and a network ({self.network})" if self.network else ""
        lines = [
            f"{', '.join(self.files)}: {self.rig} with "
            f"{', '.join(self.effects) or 'no effect'}{network}{built}.",
            f"Every {self.period_s:g} s: {', '.join(self.inputs)} -> {', '.join(self.outputs)}",
        ]
        if (errors := self.plain_mujoco) is not None:
            used, best = settings_words(errors), errors.best
            lines.append(f"Mean absolute error on held-out data, in plain MuJoCo ({used}):")
            for name, c in errors.channels.items():
                stated = "" if c.stated is None else f"; the run predicts {c.stated:.4g}"
                lines.append(f"  {name}: {c.before:.4g} with the old file, {c.now:.4g} now{stated}")
            if (best.timestep_s, best.integrator) != (errors.timestep_s, errors.integrator):
                figures = ", ".join(f"{name} {c.best:.4g}" for name, c in errors.channels.items())
                reach = "reaches" if errors.reached else "is closest to"
                lines.append(
                    f"{best.integrator} with {1e3 * best.timestep_s:g} ms {reach} the predicted "
                    f'error ({figures}): <option timestep="{best.timestep_s:g}" '
                    f'integrator="{best.integrator}"/>'
                )
            elif errors.reached is False:
                lines.append("No other step or integrator is better.")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<ExportResult {', '.join(self.files)}>"


@verb(ExportArguments)
def export(arguments: ExportArguments) -> ExportResult:
    """Write an identified model as FMU, C, ONNX, MATLAB function, MJCF or URDF.

    Raises
    ------
    FileError
        A file exists (without overwrite), a model file got worse (without anyway), or the run is
        damaged or incomplete.
    UsageError
        The form is unknown or cannot hold the model.
    """
    a = arguments
    run = OpenedRun.of(a.run)
    tell("reading")
    identified = load_identified(
        run.folder,
        which=a.which,
        rig=resolved_rig(a.rig) or run.code[0],
        effects=effects_given(a.effects) or run.code[1],
        choose=a.choose,
    )
    model = identified.knowing(a.known or {})
    written = export_model(
        model,
        a.form,
        None if a.output is None else Path(a.output),
        overwrite=a.overwrite,
        anyway=a.anyway,
        randomise=None if a.randomise is None else Path(a.randomise),
    )
    files = tuple(map(str, written.files))
    warn = a.warn or warn_in_python
    for note in written.notes:
        warn(f"{files[0]}: {note}.")
    checked = {} if written.check is None else {"plain_mujoco": written.check.errors}
    return ExportResult(
        to=a.form,
        files=files,
        binary=written.binary,
        rig=model.name,
        effects=tuple(each.label for each in model.effects),
        network="" if model.network is None else model.network.trained.network.kind,
        period_s=model.period_s,
        inputs=model.inputs,
        outputs=model.outputs,
        notes=written.notes,
        **checked,
    )
