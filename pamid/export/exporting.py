"""Write an identified model in the form that a user asks for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import UsageError, nearest
from pamid.base.files import make_folder, require_new, write_together
from pamid.base.progress import tell
from pamid.correction.identified_model import Identified
from pamid.export.c_source import model_name
from pamid.export.form import known_forms
from pamid.export.step import SampleStep, step_of


@dataclass(frozen=True)
class Exported:
    """What was written; binary: the platform that an FMU was built for, "" for none; notes: what
    the user has to know.
    """

    step: SampleStep
    files: tuple[Path, ...]
    binary: str = ""
    notes: tuple[str, ...] = ()


def export_model(
    model: Identified, form: str, path: Path | None = None, *, overwrite: bool = False
) -> Exported:
    """Write `model` to `path` (default: the model's name with the ending of the form, here).

    FileError where a file exists and `overwrite` is not given, UsageError for an unknown form, and
    what the form refuses.
    """
    forms = known_forms()
    if form not in forms:
        raise UsageError(f"{form!r} is no form of export.", nearest(form, forms))
    tell("translating")
    chosen, step = forms[form], step_of(model)
    files = chosen.files(step, path or Path(f"{model_name(step)}{chosen.ending}"))
    require_new(files, overwrite)
    made = chosen.write(model, step, files)
    for folder in {file.parent for file in files}:
        make_folder(folder)
    write_together(made.files)
    return Exported(step, files, made.binary, (*model.notes, *made.notes))
