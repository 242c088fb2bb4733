"""The vocabulary of equations, for rig and effect files: `from pamid.equations import maximum,
sqrt, where`.

Part of the face, as `pamid` itself: nothing inside the package imports it.
"""

from pamid.engine.symbolic.vocabulary import *  # noqa: F403
from pamid.engine.symbolic.vocabulary import __all__ as __all__
