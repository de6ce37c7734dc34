"""Connected parts of meshes and of other graphs."""

import numpy as np

from sarmitsuba.core.arrays import I32, I64


def label_connected(count: int, first: I64 | I32, second: I64 | I32) -> I64:
    """Number of the connected part of each of ``count`` nodes, (count,) int64; parts are numbered by their first nodes.

    Two rounds at least halve the number of parts that have to be joined. Importing SciPy's search takes longer (0.07 s)
    than most scenes' meshes.

    Parameters
    ----------
    first, second : (n,) nodes at both ends of each link
    """
    # the least known node of each part; the parts at both ends of a link are joined at the lesser one
    root = np.arange(count)
    a, b = root[first], root[second]
    while (apart := a != b).any():
        first, second = first[apart], second[apart]
        np.minimum.at(root, np.maximum(a, b)[apart], np.minimum(a, b)[apart])
        while ((above := root[root]) != root).any():
            root = above
        a, b = root[first], root[second]
    return np.unique(root, return_inverse=True)[1].reshape(-1).astype(np.int64)
