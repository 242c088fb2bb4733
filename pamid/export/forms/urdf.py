"""`pamid export --to urdf`: the URDF of the rig, with what URDF can hold of the finding."""

from __future__ import annotations

from pathlib import Path

from pamid.correction.identified_model import Identified
from pamid.export.form import Form, Written
from pamid.export.model_text import write_model_text


def write(model: Identified, step: None, files: tuple[Path, ...]) -> Written:
    return write_model_text(model, "urdf", files)


FORM = Form(".urdf", write, sampled=False)
