"""Types of NumPy arrays, named for their elements; shapes and units are stated where they are used."""

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
# two 32-bit floats, and two of 64 bits
C64 = NDArray[np.complex64]
C128 = NDArray[np.complex128]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
