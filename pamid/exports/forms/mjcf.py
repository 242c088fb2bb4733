"""`pamid export --to mjcf`: the MuJoCo file of the rig with the identified values."""

from __future__ import annotations

from functools import partial

from pamid.exports.form import Form
from pamid.exports.model_text import write_model_text

FORM = Form(".xml", partial(write_model_text, language="mjcf"), sampled=False)
