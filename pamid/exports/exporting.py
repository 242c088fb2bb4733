"""Export of an identified model in a chosen form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pamid.base.errors import FileError, UsageError, nearest
from pamid.base.files import make_folder, require_new, write_together
from pamid.base.progress import tell
from pamid.exports.form import Written, known_forms
from pamid.exports.randomisation import randomisation_yaml
from pamid.exports.statements import identifier
from pamid.exports.step import step_of
from pamid.networks.correction.identified_model import Identified


def export_model(
    model: Identified,
    form: str,
    path: Path | None = None,
    *,
    overwrite: bool = False,
    anyway: bool = False,
    randomise: Path | None = None,
) -> Written:
    """Write an identified model.

    Parameters
    ----------
    path
        File or folder; by default the model's name with the ending of the form, in the working
        folder.
    anyway
        Write a model file even if it is worse than its original.
    randomise
        Further file for the ranges of the parameters.

    Raises
    ------
    FileError
        A file exists and `overwrite` is not given, or a model file got worse.
    UsageError
        The form is unknown, or it refuses the model.
    """
    forms = known_forms()
    if form not in forms:
        raise UsageError(f"{form!r} is not an export format.", nearest(form, forms))
    tell("translating")
    chosen = forms[form]
    step = step_of(model) if chosen.sampled else None
    default = Path(f"{identifier(f'pamid_{model.name}')}{chosen.ending}")
    files = chosen.files(step, path or default)
    further = () if randomise is None else (randomise,)
    require_new((*files, *further), overwrite)
    ranges = {path: randomisation_yaml(model) for path in further}
    written = chosen.write(model, step, files)
    if written.check is not None and written.check.is_worse and not anyway:
        raise FileError(
            f"{files[0]} was not written: {written.check.worst_words}.",
            "Write the file with --anyway: its notes list the effects that the file format cannot "
            "represent.",
            code="worse",
        )
    for folder in {file.parent for file in (*files, *further)}:
        make_folder(folder)
    content = {**written.files, **ranges}
    write_together(content)
    return replace(written, files=content, notes=(*model.notes, *written.notes))
