"""`pamid export --to matlab`: a function file."""

from __future__ import annotations

from pathlib import Path

from pamid.exports.form import Form, Written
from pamid.exports.m_source import m_file
from pamid.exports.statements import identifier
from pamid.exports.step import SampleStep
from pamid.networks.correction.identified_model import Identified


def write(model: Identified, step: SampleStep, files: tuple[Path, ...]) -> Written:
    (file,) = files
    return Written({file: m_file(step, file.stem).encode()})


# a function is called by the name of its file
FORM = Form(".m", write, lambda _, path: (path.with_name(f"{identifier(path.stem)}.m"),))
