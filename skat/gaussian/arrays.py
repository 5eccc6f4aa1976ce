"""Names for arrays in signatures."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["AnyArray", "Flags", "Floats", "Places"]

# Of NumPy, dask, torch or another library, a data frame, or lists of numbers: no type of Python's names them all.
AnyArray: TypeAlias = Any
Floats: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.bool_]
Places: TypeAlias = NDArray[np.intp]
