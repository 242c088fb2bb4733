"""pamid: where a grey-box model departs from its rig, which effect causes it, and how far the gap
shrinks.

The face: the nouns that a rig file, an effect file or a script needs. Each is loaded when it is
first asked for, so that `import pamid` costs nothing. Nothing inside the package imports the face.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pamid.base.errors import PamidError
    from pamid.model.assembly import Assembly
    from pamid.model.background import Gain, SmoothGain, SplitGain
    from pamid.model.effect import Effect, State
    from pamid.model.parameter import Parameter
    from pamid.model.rig import Loop, Port, Rig
    from pamid.recording.recording import Recording

__version__ = "0.1.0"
__all__ = [
    "Assembly",
    "Effect",
    "Gain",
    "Loop",
    "PamidError",
    "Parameter",
    "Port",
    "Recording",
    "Rig",
    "SmoothGain",
    "SplitGain",
    "State",
    "__version__",
]

_HOME = {
    "Assembly": "pamid.model.assembly",
    "Effect": "pamid.model.effect",
    "Gain": "pamid.model.background",
    "Loop": "pamid.model.rig",
    "PamidError": "pamid.base.errors",
    "Parameter": "pamid.model.parameter",
    "Port": "pamid.model.rig",
    "Recording": "pamid.recording.recording",
    "Rig": "pamid.model.rig",
    "SmoothGain": "pamid.model.background",
    "SplitGain": "pamid.model.background",
    "State": "pamid.model.effect",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'pamid' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
