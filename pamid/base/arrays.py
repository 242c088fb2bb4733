"""The array of all computations, as annotations name it."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

#: float64, of any shape
Array: TypeAlias = NDArray[np.float64]
