"""`pamid export --to onnx`: a sample and a whole run."""

from __future__ import annotations

from pathlib import Path

from pamid.exports.form import Form, Written
from pamid.exports.onnx_model import onnx_bytes
from pamid.exports.step import SampleStep
from pamid.networks.correction.identified_model import Identified


def write(model: Identified, step: SampleStep, files: tuple[Path, ...]) -> Written:
    return Written(dict(zip(files, onnx_bytes(model), strict=True)))


def run_and_cell(step: SampleStep, path: Path) -> tuple[Path, ...]:
    return path, path.with_name(f"{path.stem}-cell.onnx")


FORM = Form(".onnx", write, run_and_cell)
