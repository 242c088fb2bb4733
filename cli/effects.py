"""`pamid effects`: List the catalogue of effects, or explain an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pamid.api.options.record import EffectName, RigName, argument, option
from pamid.base.errors import FileError, UsageError, nearest

from . import frame

HELP_ORDER = 140
EXAMPLE = """
pamid effects
pamid effects --symptom stops-short
pamid effects coulomb-friction --rig one-dof
"""


@dataclass(frozen=True)
class Arguments:
    """List the effects by family and kind of port, or explain an effect: NAME, or the path of an
    effect file. The name of a family, such as friction, lists its effects.

    An explanation has a description, the appearance in a recording, similar effects, the equation,
    references, parameters with ranges and sources, and the ports where the effect fits.
    """

    name: EffectName | None = argument(default=None)
    rigs: Sequence[RigName] = option(
        (), "Rig (name or file) to look for fitting ports. [default: all rigs]", "--rig"
    )
    free: bool = option(
        False,
        "Also list the nonparametric curves of the families, which describe effects outside the "
        "catalogue.",
        "--free-forms",
    )
    symptom: str | None = option(
        None,
        "List the effects whose error has this shape, such as stops-short, reversals or lags "
        "(an unknown name lists all).",
        metavar="NAME",
    )


@frame.command("effects", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.base.schemas.catalogue_files import EffectCatalogue
    from pamid.base.symptoms import SYMPTOMS
    from pamid.model import catalogue
    from pamid.model import registry as library
    from pamid.model.attachment import attachments

    name, symptom = arguments.name, arguments.symptom
    if symptom not in (None, *SYMPTOMS):
        raise UsageError(f"There is no symptom {symptom!r}.", f"Symptoms: {', '.join(SYMPTOMS)}.")
    looked_at = [library.rig_named(rig) for rig in arguments.rigs] or [
        library.rig_named(rig) for rig in library.rigs()
    ]
    known = library.all_effects() if arguments.free else library.effects()
    family = {
        n for n, kind in known.items() if name in catalogue.effect_row(kind).families.values()
    }
    if name is None or (family and name not in known):
        fit = (
            {a.effect.name for rig in looked_at for a in attachments(rig, known.values())}
            if arguments.rigs
            else set(known)
        )
        fit = fit & family if name else fit
        fit = {n for n in fit if symptom in (None, *known[n].symptoms)}
        rows = tuple(catalogue.effect_row(known[effect]) for effect in sorted(fit))
        return frame.Result(EffectCatalogue(effects=rows), catalogue.effects_text(rows))
    known, (wanted,) = library.effects_with((name,))
    if wanted not in known:
        raise FileError(
            f"There is no effect {wanted!r}.",
            nearest(wanted, known) or "See `pamid effects` for all.",
            code="unknown-effect",
        )
    story = catalogue.effect_story(known[wanted], looked_at, known.values())
    return frame.Result(EffectCatalogue(effect=story), catalogue.effect_text(story))
