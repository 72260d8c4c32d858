"""What kernels are handed again and again, as one object.

Numba takes a tuple over from Python array by array, at each call: some 0.25 µs each. A list of its own is taken over as
it is, whatever is in it. So what a space keeps for its plans is in lists of one tuple.
"""

from __future__ import annotations

from typing import Any

from numba import njit
from numba.typed import List


@njit(cache=True, nogil=True)
def boxed(content: tuple[Any, ...]) -> Any:  # noqa: ANN401 - a sequence of what it is given
    """A list of Numba's own that holds one tuple of arrays, which live as long as it does."""
    box = List()
    box.append(content)
    return box
