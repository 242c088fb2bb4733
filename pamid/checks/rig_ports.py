"""Ports of a checked rig, for its drawing."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import PamidError
from pamid.model.port_flow import rig_map
from pamid.model.registry import rig_named
from pamid.model.rig import Rig
from pamid.schemas.rig_map import RigMap


def checked_ports(source: Path | type[Rig]) -> RigMap | None:
    """Ports of a rig, or of a rig file or model that the user named (which is run).

    None if it does not build.
    """
    try:
        rig = rig_named(str(source)) if isinstance(source, Path) else source()
        return rig_map(rig, rig.outputs)
    except PamidError:
        return None
