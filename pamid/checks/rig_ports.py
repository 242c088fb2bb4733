"""The ports of a rig that is checked, for its drawing."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import PamidError
from pamid.model.port_flow import rig_map
from pamid.model.registry import rig_named
from pamid.model.rig import Rig
from pamid.schemas.rig_map import RigMap


def checked_ports(source: Path | type[Rig]) -> RigMap | None:
    """Those of a rig, or of a rig file or model that the user has named (it is run); None where it
    does not build."""
    try:
        rig = rig_named(str(source)) if isinstance(source, Path) else source()
        return rig_map(rig, rig.outputs)
    except PamidError:
        return None
