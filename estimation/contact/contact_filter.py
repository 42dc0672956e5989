"""Real-time filter for the contact wrench, sample by sample, with a constant known delay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.contact.calibrated_model import CalibratedModel
from estimation.contact.local_polynomial import LocalPolynomial
from estimation.contact.row_signals import ColumnDerivative, RowSignals
from estimation.fit import Fit
from modeling.chain.contact_gain import contact_gain_at, group_delay
from modeling.codegen.casadi_sample import CasadiSample, RecursiveFunction, state_size
from modeling.codegen.fitted_model import sample_inputs, sample_program
from modeling.errors import InputError
from modeling.rig.rig import Rig
from modeling.space import signals
from modeling.table import Table, Tabular
from modeling.tool.wrench_components import contact_components

Array = NDArray[np.float64]
FilterRow = Mapping[str, float] | ArrayLike


class ContactFilter(Tabular):
    """Contact wrench row by row, the real-time counterpart of `compensate`.

    At each sample `update` takes the current motion and reading and gives the contact wrench (p,), N and N m, of the
    environment on the tool with the signs and axes of `modeling.tool.wrench_components`, of `delay` seconds ago. The
    result is None for the first rows, until the window is full and the transfer function's initial transient has
    decayed (`warm_up`). A row with a missing value restarts the filter.

    Parameters
    ----------
    fitted : Fit or CalibratedModel
        The fitted model of the tool; recording-specific effects are dropped.
    columns : sequence of str
        Columns of a row besides the model's channels: motion and auxiliary, named as in FORMATS, SI.
    window : LocalPolynomial
        Window that differentiates the motion and smooths the reading; its `dt` is the sampling interval.
    rig : Rig, optional
        The kinematics that joint angles need.
    zero : array (p,), optional
        The readings' zero of this session, in the channels' units; by default the calibration's biases. Drift that
        depends on a recorded column is added.

    Raises
    ------
    InputError
        When the model needs other signals, its transfer function cannot be run sample by sample, or `zero` is not one
        finite number for each channel.

    Notes
    -----
    One Savitzky-Golay window over all columns gives the motion's value, rate and acceleration and smooths the reading,
    so that prediction and reading have the same delay. The prediction passes the sensor's transfer function before it
    is subtracted from the reading. The contact itself is not deconvolved: the sensor's `group_delay`, relative to the
    motion's clock, adds to `delay`. A sensor that leads the motion makes `delay` longer.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), tw.read("train.csv", rig=rig))
    >>> window = tw.LocalPolynomial.of_delay(0.05, dt=0.01)
    >>> stream = tw.ContactFilter(fit, columns=["q1", "q2", "q3"], window=window, rig=rig)
    >>> stream.columns, stream.warm_up
    (('q1', 'q2', 'q3', 'fx', 'fy', 'tau'), 11)
    >>> results = [stream.update([0, 0, 0.5, 15, 0.2, -1.3]) for _ in range(stream.warm_up)]
    >>> results[0] is None, results[-1].shape
    (True, (3,))
    """

    def __init__(
        self,
        fitted: Fit | CalibratedModel,
        *,
        columns: Sequence[str],
        window: LocalPolynomial,
        rig: Rig | None = None,
        zero: ArrayLike | None = None,
    ) -> None:
        """A filter that has received no row."""
        calibration = fitted if isinstance(fitted, CalibratedModel) else CalibratedModel.of(fitted)
        self.calibration = calibration.without_recording_specific
        self.window = window
        model, theta = self.calibration.model, self.calibration.theta
        biases = len(model.biases)
        self.zero = np.array(theta[:biases] if zero is None else zero, dtype=float)
        if self.zero.shape != (biases,) or not np.isfinite(self.zero).all():
            raise _error(f"a zero {self.zero.tolist()} for {biases} channels", "give one number for each channel")
        self.motion = RowSignals.of(columns, model.channels, rig)
        self.columns = (*self.motion.columns, *model.channels)
        self._program = sample_program(model, theta, window.dt)
        self._derivatives, self._function = self._compiled()
        self._inverse = np.linalg.inv(contact_gain_at(model, theta)[0])
        order = np.array([d.order for d in self._derivatives], dtype=np.intp)
        place = np.array([self.columns.index(d.column) for d in self._derivatives], dtype=np.intp)
        self._order_and_column = order, place
        self.restart()

    def _compiled(self) -> tuple[tuple[ColumnDerivative, ...], Any]:
        """Column derivatives that the model needs, and the CasADi function of one sample.

        From the derivatives, the biases, the reading and the state to the residual, reading minus prediction, and the
        next state.
        """
        import casadi as ca

        model, theta = self.calibration.model, self.calibration.theta
        derivatives, given, graphs = self.motion.graphs(model)
        zero, reading = (ca.SX.sym(name, len(model.channels)) for name in ("zero", "reading"))
        state = ca.SX.sym("state", state_size(self._program))
        values = dict(zip((p.symbol for p in model.parameters), map(ca.SX, theta), strict=True))
        values |= dict(zip((p.symbol for p in model.biases), ca.vertsplit(zero), strict=True))
        values |= dict(zip(signals(*sample_inputs(model)), graphs, strict=True))
        sample = CasadiSample.of(self._program, values, reading, state)
        results = [ca.densify(sample.measured - sample.prediction), ca.densify(sample.next_state)]
        return derivatives, ca.Function("row", [given, zero, reading, state], results)

    # ---------------------------------------------------------------------------------------- running

    def restart(self) -> None:
        """Clear all rows and states."""
        self._step = RecursiveFunction(self._function)
        self._rows = np.zeros((self.window.samples, len(self.columns)))
        self._row_count = 0

    def update(self, row: FilterRow) -> Array | None:
        """The contact wrench (p,), N and N m, `delay` seconds before this row; None during `warm_up`.

        The row is a mapping by name (further names are ignored) or an array in the order of `columns`, SI.
        Raises InputError when a column is missing.
        """
        residual = self._residual(row)
        return None if residual is None else self._inverse @ residual

    def rezero(self, rows: Iterable[FilterRow]) -> ContactFilter:
        """A new filter with the mean zero of these rows, which must be contact-free.

        Raises InputError when they are too few for one result.
        """
        restarted = self._with_zero(self.zero)
        residuals = [r for r in map(restarted._residual, rows) if r is not None]
        if not residuals:
            raise _error(f"no result before row {self.warm_up}", "give more rows without contact")
        return self._with_zero(self.zero + np.mean(residuals, axis=0))

    def _with_zero(self, zero: Array) -> ContactFilter:
        other = copy(self)
        other.zero = zero
        other.restart()
        return other

    def _residual(self, row: FilterRow) -> Array | None:
        """Residual (p,), measured minus predicted, in the channels' units."""
        values = self._values(row)
        if not np.isfinite(values).all():
            self.restart()
            return None
        self._rows[:-1] = self._rows[1:]
        self._rows[-1] = self.motion.unwrapped(values, self._rows[-2] if self._row_count else values)
        self._row_count += 1
        if self._row_count < self.window.samples:
            return None
        moments = self.window.kernels @ self._rows
        reading = np.ascontiguousarray(moments[0, len(self.motion.columns) :])
        (residual,) = self._step(moments[self._order_and_column], self.zero, reading)
        return residual if self._row_count >= self.warm_up else None

    def _values(self, row: FilterRow) -> Array:
        if isinstance(row, Mapping):
            missing = [name for name in self.columns if name not in row]
            if missing:
                raise _error(f"a row without {', '.join(missing)}", f"give {', '.join(self.columns)}")
            return np.array([row[name] for name in self.columns], dtype=float)
        values = np.asarray(row, dtype=float)
        if values.shape != (len(self.columns),):
            raise _error(f"a row of shape {values.shape}", f"give {', '.join(self.columns)}")
        return values

    # --------------------------------------------------------------------------------- properties

    @property
    def delay(self) -> float:
        """Delay (s) of the contact wrench after its reading: half the window, and the wait for a leading sensor."""
        return self.window.delay + self._program.latency * self.window.dt

    @property
    def group_delay(self) -> float:
        """Group delay (s) of the sensor at low frequency, relative to the motion's clock."""
        return group_delay(self.calibration.model, self.calibration.theta)

    @property
    def warm_up(self) -> int:
        """Rows up to and including the first result."""
        return self.window.samples + max(self._program.latency, self._program.settling)

    @property
    def bandwidth(self) -> float:
        """Frequency (Hz) at which the window's gain is 1/sqrt(2) (-3 dB)."""
        return self.window.bandwidth

    @property
    def covariance(self) -> Array:
        """Covariance (p, p) of one result under white noise of the calibration's std; the motion is taken as exact.

        Results within one window of each other are correlated.
        """
        spread = self._inverse * (self.calibration.floor * self.window.norms[0])
        return np.asarray(spread @ spread.T)

    @property
    def std(self) -> Array:
        """Standard deviation (p,) of one result, N and N m."""
        return np.sqrt(np.diag(self.covariance))

    def unfollowed(self, frequency: ArrayLike) -> Array:
        """Share (k,) of an inertial load at these frequencies (Hz) that leaks into the contact wrench.

        The difference of the window's gains for the reading (value) and for the highest derivative in use (acceleration
        or rate). Zero when no column is differentiated.
        """
        value = self.window.gain(frequency)
        return np.asarray(value - self.window.gain(frequency, max((d.order for d in self._derivatives), default=0)))

    @property
    def table(self) -> Table:
        """Delay, bandwidth, noise and leakage of inertial loads."""
        names = contact_components(self.calibration.model.space)
        units = self.calibration.model.space.units
        noise = ", ".join(f"{n} {s:.3g} {u}" for n, s, u in zip(names, self.std, units, strict=True))
        share = 100 * abs(float(self.unfollowed(self.bandwidth / 4)[0]))
        rows = [
            ("delay", f"{self.delay:.6g} s"),
            ("sensor's group delay", f"{self.group_delay:.6g} s"),
            ("first result at row", f"{self.warm_up}"),
            ("bandwidth (-3 dB)", f"{self.bandwidth:.4g} Hz"),
            ("noise (std)", noise),
            (
                "noise of derived accelerations",
                f"{self.window.norms[2]:.3g} /s² times that of the differentiated column",
            ),
            ("inertial load leaking into contact", f"{share:.2g} % at {self.bandwidth / 4:.3g} Hz"),
        ]
        return Table.of(("contact filter", "value"), rows)


def _error(what: str, remedy: str) -> InputError:
    return InputError(what=what, where="contact filter", remedy=remedy)
