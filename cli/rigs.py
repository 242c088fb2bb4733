"""`pamid rigs`: List the rigs, or explain one."""

from __future__ import annotations

import click

from . import frame, names

PLACE = 150
EXAMPLE = """
pamid rigs
pamid rigs one-dof
"""


@frame.command("rigs", example=EXAMPLE)
@click.argument("name", required=False, type=names.RIG_NAMES)
def command(name: str | None) -> frame.Result:
    """List the rigs, or explain one: NAME, NAME:VARIANT, or the path of a rig file.

    The story of a rig: inputs, outputs, states, ports and the effects that fit there, parameters
    with their sources, background terms, and its equations, in which whatever passes through a port
    bears the name of the port.
    """
    from pamid.model import catalogue
    from pamid.model import registry as library
    from pamid.schemas.catalogue_files import RigCatalogue

    if name is None:
        rows = tuple(catalogue.rig_row(rig) for rig in library.rigs().values())
        lines = [f"{row.name:<20} {row.title}" for row in rows]
        lines += ["", f"One of them, or a file of yours: pamid rigs {rows[0].name}"]
        return frame.Result(RigCatalogue(rigs=rows), "\n".join(lines))
    said = catalogue.rig_story(library.rig_named(name), library.effects().values())
    return frame.Result(RigCatalogue(rig=said), catalogue.rig_text(said))
