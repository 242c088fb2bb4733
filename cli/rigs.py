"""`pamid rigs`: List the rigs, or explain a rig."""

from __future__ import annotations

from dataclasses import dataclass

from pamid.api.options.record import (
    FilePath,
    RigName,
    argument,
    option,
)
from pamid.base.errors import UsageError

from . import frame
from .figures import require_png, write_figure

HELP_ORDER = 150
EXAMPLE = """
pamid rigs
pamid rigs one-dof --figure joint.png
"""


@dataclass(frozen=True)
class Arguments:
    """List the rigs, or explain a rig: NAME, NAME:VARIANT, or the path of a rig file.

    An explanation has inputs, outputs, states, ports with the effects that fit there, parameters
    with sources, tolerances, and the equations. A quantity at a port has the name of the port.
    """

    name: RigName | None = argument(default=None)
    named: RigName | None = option(None, "The same as NAME.", "--rig")
    everything: bool = option(False, "Print equations of any length.", "--all")
    figure: FilePath | None = option(None, "PNG to draw: the rig as a block diagram of its ports.")
    overwrite: bool = option(False, "Replace the figure if it exists.")


@frame.command("rigs", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.base.schemas.catalogue_files import RigCatalogue
    from pamid.model import catalogue
    from pamid.model import registry as library

    name, figure = arguments.name or arguments.named, arguments.figure
    if figure is not None and name is None:
        raise UsageError(
            "--figure draws a single rig.", "Name it: pamid rigs one-dof --figure rig.png."
        )
    require_png(figure, arguments.overwrite)
    if name is None:
        rows = tuple(catalogue.rig_row(rig) for rig in library.rigs().values())
        lines = [f"{row.name:<20} {row.title}" for row in rows]
        lines += ["", f"Explain a rig, or a rig file: pamid rigs {rows[0].name}"]
        return frame.Result(RigCatalogue(rigs=rows), "\n".join(lines))
    rig = library.rig_named(name)
    story = catalogue.rig_story(rig, library.effects().values(), library.rigs())
    text = catalogue.rig_text(story, everything=arguments.everything)
    if figure is not None:
        from pamid.model.port_flow import rig_map
        from pamid.report.rig_figure import bare_rig_drawing
        from pamid.report.style import png_of

        drawing = bare_rig_drawing(rig_map(rig, rig.outputs))
        text += f"\n{write_figure(figure, png_of(drawing))}"
    return frame.Result(RigCatalogue(rig=story), text)
