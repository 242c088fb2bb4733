"""The vocabulary of equations, for rig and effect files: `from pamid.equations import maximum,
sqrt, where`.

Part of the face, as `pamid` itself: nothing inside the package imports it.
"""

from pamid.symbolic.vocabulary import *  # noqa: F403
from pamid.symbolic.vocabulary import __all__ as __all__
