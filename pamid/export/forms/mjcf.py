"""`pamid export --to mjcf`: the MuJoCo file of the rig, with what was found; MuJoCo runs it."""

from __future__ import annotations

from pathlib import Path

from pamid.correction.identified_model import Identified
from pamid.export.form import Form, Written
from pamid.export.model_text import write_model_text


def write(model: Identified, step: None, files: tuple[Path, ...]) -> Written:
    return write_model_text(model, "mjcf", files)


FORM = Form(".xml", write, sampled=False)
