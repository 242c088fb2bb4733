"""pamid: where a grey-box model departs from its rig, which effect causes it, and how far the gap shrinks.

The face: the nouns that a rig file, an effect file or a script needs. Nothing inside the package imports it.
"""

from pamid.assembly import Assembly
from pamid.effect import Effect, State
from pamid.errors import PamidError
from pamid.parameter import Parameter
from pamid.recording import Recording
from pamid.rig import Loop, Port, Rig

__version__ = "0.1.0"
__all__ = ["Assembly", "Effect", "Loop", "PamidError", "Parameter", "Port", "Recording", "Rig", "State",
           "__version__"]
