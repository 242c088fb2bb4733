"""Write an identified model in the form that a user asks for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError
from pamid.base.files import make_folder, write_atomically, write_together
from pamid.correction.identified_model import Identified
from pamid.export.c_source import c_files, model_name
from pamid.export.fmu import make_fmu
from pamid.export.m_source import m_file
from pamid.export.statements import identifier
from pamid.export.step import SampleStep, step_of

#: what may be asked for -> ending of its file ("": a folder)
FORMS = {"fmu": ".fmu", "fmu2": ".fmu", "fmu3": ".fmu", "c": "", "onnx": ".onnx", "matlab": ".m"}
FMI = {"fmu": 2, "fmu2": 2, "fmu3": 3}
HOW_TO_BUILD = (
    "it holds sources only: build it where it is to run, with `fmpy compile`, Simulink's "
    "fmudialog.compileFMUSources or the importer's own compiler"
)


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

    FileError where a file exists and `overwrite` is not given.
    """
    step = step_of(model)
    path = path or Path(f"{model_name(step)}{FORMS[form]}")
    if form == "c":
        texts = {path / name: text for name, text in c_files(step).items()}
    elif form == "matlab":  # a function is called by the name of its file
        path = path.with_name(f"{identifier(path.stem)}.m")
        texts = {path: m_file(step, path.stem)}
    else:
        texts = dict.fromkeys(
            (path, *([path.with_name(f"{path.stem}-cell.onnx")] if form == "onnx" else [])), ""
        )
    taken = [p for p in texts if p.exists()]
    if taken and not overwrite:
        raise FileError(
            f"{taken[0]} exists already.",
            "Choose another --output, or --overwrite to replace it.",
            code="exists",
        )
    for folder in {p.parent for p in texts}:
        make_folder(folder)
    if form == "onnx":
        from pamid.export.onnx_model import write_onnx  # its package is an extra

        return Exported(step, write_onnx(model, path))
    if form in FMI:
        made = make_fmu(step, FMI[form])
        write_atomically(path, made.data)
        return Exported(
            step, (path,), made.binary, (f"{made.why}; {HOW_TO_BUILD}",) if made.why else ()
        )
    write_together({file: text.encode() for file, text in texts.items()})
    return Exported(step, tuple(texts))
