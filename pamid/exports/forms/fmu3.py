"""`pamid export --to fmu3`: FMI 3.0 for co-simulation, with the same."""

from __future__ import annotations

from functools import partial

from pamid.exports.fmu import write_fmu
from pamid.exports.form import Form

FORM = Form(".fmu", partial(write_fmu, version=3))
