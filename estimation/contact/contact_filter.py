"""ContactFilter: the contact wrench sample by sample, of a time that is exactly so long ago."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.contact.calibration import Calibration
from estimation.contact.local_polynomial import LocalPolynomial
from estimation.contact.row_motion import RowMotion, Tap
from estimation.fit import Fit
from estimation.linear.estimate import table
from modeling import symbolic as sp
from modeling.contact import components
from modeling.contact_gain import contact_gain_at, lateness
from modeling.errors import InputError
from modeling.memory import Memory
from modeling.rig import Rig
from modeling.running_memory import RunningMemory

Array = NDArray[np.float64]
Row = Mapping[str, float] | ArrayLike


class ContactFilter:
    """Row by row, what `compensate` gives for a whole recording.

    At each tick `update` takes the motion and the reading of now and gives the contact wrench (p,), of the environment
    on the tool with the signs and axes of `modeling.contact`, of `delay` seconds ago. One local polynomial moves over
    all columns: it gives the motion's value, rate and acceleration and smooths the reading, so that prediction and
    reading are equally late. The prediction passes the sensor's memory before the reading is compared with it. What
    the memory does to the contact itself is left as it is: the contact is `late` by that on top of `delay`, with the
    motion's clock as the reference and for slow changes. A sensor that leads the motion makes `delay` longer.

    There is no result (None) until every sample in use was measured and the memory's start is forgotten: `warm_up`
    rows. A row with a missing value begins this anew.
    """

    def __init__(
        self,
        fitted: Fit | Calibration,
        *,
        columns: Sequence[str],
        window: LocalPolynomial,
        rig: Rig | None = None,
        zero: ArrayLike | None = None,
    ) -> None:
        """A filter for rows of `columns` (motion and auxiliary, named as in FORMATS) and the model's channels.

        `zero` (p,) is the readings' zero of this session in the channels' units, by default the calibration's biases;
        a drift that follows a recorded column comes on top. `rig` gives the kinematics that joint angles need.
        Raises InputError when the model takes signals that such rows do not give, or has a memory that cannot be run.
        """
        self.calibration = (fitted if isinstance(fitted, Calibration) else Calibration.of(fitted)).lasting
        self.window = window
        model, theta = self.calibration.model, self.calibration.theta
        model.require_direct("contact filter")
        biases = len(model.biases)
        self.zero = np.array(theta[:biases] if zero is None else zero, dtype=float)
        if self.zero.shape != (biases,) or not np.isfinite(self.zero).all():
            raise _error(f"a zero {self.zero.tolist()} for {biases} channels", "give one number for each channel")
        self._shift = self.zero - theta[:biases]
        self.motion = RowMotion.of(columns, model.channels, rig)
        self.columns = (*self.motion.columns, *model.channels)
        self._taps, self._function = self._compiled()
        values = dict(zip((p.symbol for p in model.parameters), theta, strict=True))
        self._transfer = Memory.of(model.memory).at(values)
        self._inverse = np.linalg.inv(contact_gain_at(model, theta)[0])
        order = np.array([tap.order for tap in self._taps], dtype=np.intp)
        place = np.array([self.columns.index(tap.column) for tap in self._taps], dtype=np.intp)
        self._taken = order, place
        self.restart()

    def _compiled(self) -> tuple[tuple[Tap, ...], Any]:
        """The taps of a row's motion that the model takes, and the CasADi function of them to load and zero (2p)."""
        model = self.calibration.model
        expression = self.motion.put_into(sp.Matrix.vstack(model.load, model.zero), model)
        return self.motion.function(expression, [p.symbol for p in model.parameters])

    # ---------------------------------------------------------------------------------------- running

    def restart(self) -> None:
        """Forget all rows."""
        self._predict = _direct(self._function, self.calibration.theta)
        self._memory = RunningMemory(self._transfer, self.window.dt)
        self._rows = np.zeros((self.window.samples, len(self.columns)))
        self._seen = 0
        self._readings: deque[Array] = deque(maxlen=self._memory.wait + 1)

    def update(self, row: Row) -> Array | None:
        """The contact wrench (p,), N and N m, `delay` seconds before this row; None while it is not known.

        The row is a mapping by name (more names do no harm) or an array in the order of `columns`, SI.
        Raises InputError when a column is missing.
        """
        residual = self._residual(row)
        return None if residual is None else self._inverse @ residual

    def rezero(self, rows: Iterable[Row]) -> ContactFilter:
        """A filter, not started, with the zero that these rows, in which nothing touches the tool, have on the average.

        Raises InputError when they are too few for one result.
        """
        fresh = self._with_zero(self.zero)
        residuals = [r for r in map(fresh._residual, rows) if r is not None]
        if not residuals:
            raise _error(f"no result before row {self.warm_up}", "give more rows without contact")
        return self._with_zero(self.zero + np.mean(residuals, axis=0))

    def _with_zero(self, zero: Array) -> ContactFilter:
        other = copy(self)
        other.zero, other._shift = zero, self._shift + zero - self.zero
        other.restart()
        return other

    def _residual(self, row: Row) -> Array | None:
        """Measured less predicted (p,), in the channels' units."""
        values = self._values(row)
        if not np.isfinite(values).all():
            self.restart()
            return None
        self._rows[:-1] = self._rows[1:]
        self._rows[-1] = self.motion.continued(values, self._rows[-2] if self._seen else values)
        self._seen += 1
        if self._seen < self.window.samples:
            return None
        moments = self.window.kernels @ self._rows
        load, zero = self._predict(moments[self._taken]).reshape(2, -1)
        self._readings.append(moments[0, len(self.motion.columns) :] - zero - self._shift)
        remembered = self._memory.step(load)
        return self._readings[0] - remembered if self._seen >= self.warm_up else None

    def _values(self, row: Row) -> Array:
        if isinstance(row, Mapping):
            missing = [name for name in self.columns if name not in row]
            if missing:
                raise _error(f"a row without {', '.join(missing)}", f"give {', '.join(self.columns)}")
            return np.array([row[name] for name in self.columns], dtype=float)
        values = np.asarray(row, dtype=float)
        if values.shape != (len(self.columns),):
            raise _error(f"a row of shape {values.shape}", f"give {', '.join(self.columns)}")
        return values

    # --------------------------------------------------------------------------------- what it does

    @property
    def delay(self) -> float:
        """Seconds between a reading and the contact wrench that is its own: half the window and the wait for a lead."""
        return self.window.delay + self._memory.wait * self.window.dt

    @property
    def late(self) -> float:
        """Seconds by which the sensor's own memory shows slow changes late, after the motion's clock."""
        return lateness(self.calibration.model, self.calibration.theta)

    @property
    def warm_up(self) -> int:
        """Rows until the first result, itself included."""
        return self.window.samples + max(self._memory.wait, self._memory.settling)

    @property
    def bandwidth(self) -> float:
        """Frequency (Hz) of a contact of which 1/sqrt(2) of the amplitude is left by the window."""
        return self.window.bandwidth

    @property
    def covariance(self) -> Array:
        """Covariance (p, p) of one result under white noise of the calibration's floor; the motion counts as exact.

        Results within one window of each other are correlated.
        """
        spread = self._inverse * (self.calibration.floor * self.window.norms[0])
        return np.asarray(spread @ spread.T)

    @property
    def std(self) -> Array:
        """Standard deviation (p,) of one result, N and N m."""
        return np.sqrt(np.diag(self.covariance))

    def unfollowed(self, frequency: ArrayLike) -> Array:
        """Share (k,) of an inertial load at these frequencies (Hz) that is taken for contact.

        The reading keeps the window's gain for values, a derived acceleration that for accelerations (for rates when it
        is derived from a rate): the difference, for the column that is derived most often. Nothing when none is.
        """
        value = self.window.gain(frequency)
        return np.asarray(value - self.window.gain(frequency, max((tap.order for tap in self._taps), default=0)))

    def rows(self) -> list[tuple[str, ...]]:
        """What, and how much of it, as text."""
        names = components(self.calibration.model.space)
        units = self.calibration.model.space.units
        noise = ", ".join(f"{n} {s:.3g} {u}" for n, s, u in zip(names, self.std, units, strict=True))
        share = 100 * abs(float(self.unfollowed(self.bandwidth / 4)[0]))
        return [
            ("delay", f"{self.delay:.6g} s"),
            ("sensor's own lateness", f"{self.late:.6g} s"),
            ("first result at row", f"{self.warm_up}"),
            ("bandwidth (-3 dB)", f"{self.bandwidth:.4g} Hz"),
            ("noise (std)", noise),
            ("acceleration's noise", f"{self.window.norms[2]:.3g} /s² times that of a column it is derived from"),
            ("inertial load taken for contact", f"{share:.2g} % at {self.bandwidth / 4:.3g} Hz"),
        ]

    def __str__(self) -> str:
        return table(("contact filter", ""), self.rows())


def _direct(function: Any, theta: Array) -> Callable[[Array], Array]:
    """A CasADi function of (u, theta) as a function of u (m,) alone, without a copy but that of its result."""
    buffer, evaluate = function.buffer()
    result = np.zeros(function.size1_out(0))

    def run(values: Array) -> Array:
        # Set anew every time: the buffer holds no reference to what it points at, this function does.
        for place, argument in enumerate((values, theta)):
            if argument.size:
                buffer.set_arg(place, memoryview(argument))  # type: ignore[arg-type]
        buffer.set_res(0, memoryview(result))  # type: ignore[arg-type]
        evaluate()
        return result.copy()

    return run


def _error(what: str, remedy: str) -> InputError:
    return InputError(what=what, where="contact filter", remedy=remedy)
