"""A compiled function of one state, at many samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampledFunction:
    """A CasADi function with one dense result (r, c), at `samples` columns of its arguments, in and out of arrays.

    CasADi writes into memory that NumPy owns: its own matrices would be turned into arrays number by number.
    """

    function: Any
    samples: int

    def __call__(self, *arguments: Array) -> Array:
        """The results (r, c, samples) at the columns of each argument (.., samples)."""
        buffer, evaluate = self._mapped.buffer()
        taken = [np.ravel(np.asarray(argument, dtype=np.float64), order="F") for argument in arguments]
        found = np.empty(self._mapped.nnz_out(0))
        for number, numbers in enumerate(taken):
            buffer.set_arg(number, numbers.data)
        buffer.set_res(0, found.data)
        evaluate()
        return found.reshape(*self.function.size_out(0), self.samples, order="F")

    @cached_property
    def _mapped(self) -> Any:
        return self.function.map(self.samples)
