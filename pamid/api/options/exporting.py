"""Arguments of `export` and `force_law`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

from pamid.api.options.names import export_forms
from pamid.api.options.record import (
    AnyPath,
    EffectName,
    RigName,
    argument,
    in_python_only,
    known_option,
    option,
    overwrite_option,
    required_option,
    which_option,
)

if TYPE_CHECKING:
    from pamid.api.given import EffectLike, Warn
    from pamid.api.workers import OpenedRun
    from pamid.model.registry import RigLike
else:
    EffectLike, RigLike, OpenedRun, Warn = EffectName, RigName, AnyPath, Any

FORMS = export_forms()


@dataclass(frozen=True)
class ExportArguments:
    """Write the model identified in RUN (rig, effects and network, if any) for use in another tool.

    Every form except mjcf and urdf reproduces `pamid simulate --model RUN --noise none` sample by
    sample. Inputs and outputs are the columns of a recording, in their units. An input is constant
    over a sample. mjcf and urdf are the model file of the rig with the identified values. That file
    is run in MuJoCo, and its errors on held-out data are printed next to those of the old file.
    """

    run: OpenedRun | AnyPath = argument("Result, or run folder.")
    form: str = required_option(
        "; ".join(
            f"{', also '.join((form, *also))}: {line}" for form, (also, line) in FORMS.items()
        )
        + ".",
        "--to",
        choices=tuple(name for form, (also, _) in FORMS.items() for name in (form, *also)),
    )
    _: KW_ONLY
    output: AnyPath | None = option(
        None, "File to write, for c a folder. [default: pamid_<rig>.<ending>]"
    )
    which: str = which_option("Model to export.")
    known: Mapping[str, float] | None = known_option(
        "Parameter with another known value in that application."
    )
    rig: RigLike | None = option(None, "Rig file of the run (it is run), or its model.")
    effects: EffectLike | Iterable[EffectLike] = option(
        (), "Effect file of the run (it is run).", "--effect"
    )
    choose: str = option(
        "",
        "Cause to write if the run could not separate several. [default: the most probable]",
        metavar="EFFECT",
    )
    anyway: bool = option(
        False, "Write a model file (mjcf, urdf) even if it is worse in MuJoCo than the original."
    )
    randomise: AnyPath | None = option(
        None,
        "Also write nominal values, standard deviations and covariance of the parameters, as YAML, "
        "for domain randomisation.",
    )
    overwrite: bool = overwrite_option("Replace what exists.", formerly="--force")
    warn: Warn | None = in_python_only(
        None, "Function that takes the notes on the files. Default: warnings.warn."
    )
