"""Arguments of `export` and `force_law`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

from pamid.api.options.names import export_forms, rigs_with
from pamid.api.options.record import (
    AnyPath,
    FolderPath,
    argument,
    in_python_only,
    known_option,
    option,
    required_option,
    seed_option,
    which_option,
)

if TYPE_CHECKING:
    from pamid.api.given import EffectLike, Warn
    from pamid.api.workers import OpenedRun
    from pamid.model.registry import RigLike

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
    overwrite: bool = option(False, "Replace what exists.", formerly="--force")
    warn: Warn | None = in_python_only(
        None, "Function that takes the notes on the files. Default: warnings.warn."
    )


@dataclass(frozen=True)
class ForceLawArguments:
    """Train an ANFIS on MAP, the measured force map of a muscle, compare it with the analytic force
    laws on held-out points, and make it the force law of a rig.

    MAP is a CSV file with the columns contraction (share of the length at rest), pressure_kpa
    (gauge) and force_n, a row per point. Other units of these are accepted, as pressure_bar. The
    analytic laws are scored as published, and with their factor `scale` fitted to the other points.
    A slack muscle reads zero force, so the network learns the amount of slack from the nearest
    analytic law.

    Writes network.json, network.npz, force-law.json, figures/force-map.png and rig.py, which works
    as any rig: --rig OUTPUT/rig.py. A rig file is code and is run when you name it. Nothing else in
    the folder is run.
    """

    map_file: AnyPath = argument("CSV of the measured map.", metavar="MAP")
    output: FolderPath = option("force-law-run", "Run folder to create.")
    _: KW_ONLY
    sets: int = option(3, "Membership sets on contraction and on pressure.", least=2, most=10)
    rig: str = option(
        "one-dof", "Rig whose muscles get the law.", choices=tuple(rigs_with("static_force"))
    )
    seed: int = seed_option("The same map and seed give the same law.")
    every: int = option(
        3,
        "Cross-validation in K folds: each holds out every K-th point.",
        "--held-out",
        metavar="K",
        least=2,
        most=20,
    )
    strict: bool = option(
        True,
        "Refuse a map in which the force falls with pressure or grows with contraction. (If only "
        "the law does so, it is constrained.)",
    )
    overwrite: bool = option(False, "Replace an earlier run in that folder.")
    warn: Warn | None = in_python_only(
        None, "Function that takes warnings. Default: warnings.warn."
    )
    command: Sequence[str] = in_python_only((), "Command that the run notes. Default: this call.")
