"""`pamid export --to urdf`: the URDF of the rig with the identified values that URDF can hold."""

from __future__ import annotations

from functools import partial

from pamid.exports.form import Form
from pamid.exports.model_text import write_model_text

FORM = Form(".urdf", partial(write_model_text, language="urdf"), sampled=False)
