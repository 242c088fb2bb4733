"""`pamid export --to c`: header, source and an example."""

from __future__ import annotations

from pathlib import Path

from pamid.exports.c_source import c_files, file_names
from pamid.exports.form import Form, Written
from pamid.exports.step import SampleStep
from pamid.networks.correction.identified_model import Identified


def write(model: Identified, step: SampleStep, files: tuple[Path, ...]) -> Written:
    texts = c_files(step)
    return Written({file: texts[file.name].encode() for file in files})


FORM = Form("", write, lambda step, folder: tuple(folder / name for name in file_names(step)))
