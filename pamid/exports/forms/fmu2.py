"""`pamid export --to fmu2`: FMI 2.0 for co-simulation, with C sources and a binary for this
machine."""

from __future__ import annotations

from functools import partial

from pamid.exports.fmu import write_fmu
from pamid.exports.form import Form

ALSO = ("fmu",)
FORM = Form(".fmu", partial(write_fmu, version=2))
