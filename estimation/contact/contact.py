"""Contact: the environment's wrench on the tool, sample by sample, with its uncertainty (22.13 corrected)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.contact.calibration import Calibration
from estimation.contact.detection import Detection, Interval, detect
from estimation.contact.point_force import PointForce
from estimation.fit import Fit, check_channels, table
from estimation.recording import Recording
from estimation.response import respond
from estimation.stream.streaming import StreamedFit
from modeling.contact import components
from modeling.contact_gain import contact_gain_at, lateness
from modeling.space import Space

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contact:
    """What the environment did to the tool during a recording.

    wrench      (n, p) of the environment on the tool, whatever the readings' signs: fcx, fcy, tauc in the plane (x',
                y', clockwise), fcx .. tcz in the sensor frame in six axes; N and N m, about the sensor origin
    noise       (p, p) covariance of one sample's noise; `doubt` (n, p, p) that of the parameters and the zero
    zero_shift  (p,) zero of the readings less that of the calibration, in the channels' units
    late        s by which the sensor's own memory shows the contact late
    unknown     per parameter that the calibration does not know, by how much a unit of it would move the contact wrench
    """

    recording: Recording
    calibration: Calibration
    detection: Detection
    wrench: Array
    noise: Array
    doubt: Array
    zero_shift: Array
    late: float
    unknown: Mapping[str, float]
    tip_length: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The components' names."""
        return components(self.space)

    @property
    def space(self) -> Space:
        """Plane or space."""
        return self.calibration.model.space

    @cached_property
    def covariance(self) -> Array:
        """Covariance (n, p, p) of each sample: noise, parameters and zero."""
        return self.noise + self.doubt

    @property
    def floor(self) -> Array:
        """Std (p,) of one sample by the sensor's noise alone, as it was where the model was fitted."""
        inverse = np.linalg.inv(contact_gain_at(self.calibration.model, self.calibration.theta)[0])
        return np.asarray(np.sqrt(inverse**2 @ self.calibration.floor**2))

    @property
    def loudness(self) -> Array:
        """Std (p,) of the calm part of this recording over that of the sensor's noise where the model was fitted."""
        return np.asarray(np.sqrt(np.diag(self.noise)) / np.maximum(self.floor, 1e-300))

    def repeating_error(self, true: Array) -> Array:
        """RMS (p,) of the error against the contact that was there (n, p), less what differs from repeat to repeat.

        The error's mean over R repeats has the mean square s² + n²/R of what repeats, s, and of noise n: PHYSICS.md,
        erratum 6. Below zero it counts as nothing. A single run's error is all counted.
        """
        error = (self.wrench - true).reshape(self.recording.repeats, -1, len(self.names))
        mean, repeats = error.mean(axis=0), len(error)
        noise = ((error - mean) ** 2).mean(axis=(0, 1)) / max(1, repeats - 1)
        return np.asarray(np.sqrt(np.maximum((mean**2).mean(axis=0) - noise, 0.0)))

    @property
    def repeating_limit(self) -> Array:
        """RMS (p,) of a repeating error that noise alone would hide: two standard errors of its power.

        That is n² sqrt(2 / (N R (R - 1))) for N samples in each of R repeats; the noise's own where there are none.
        """
        recording = self.recording
        pairs = recording.samples * (recording.repeats - 1)
        return np.asarray(self.floor * (np.sqrt(2 * np.sqrt(2 / pairs)) if pairs else 1.0))

    @cached_property
    def point_force(self) -> PointForce:
        """In the plane: the force at the end of the tip that fits best; without a tip length its two components."""
        return PointForce.of(self.wrench, self.covariance, self.noise, self.tip_length)

    @property
    def magnitude(self) -> Array:
        """Size of the contact force, N (n,)."""
        if self.space is Space.PLANE:
            return self.point_force.magnitude
        return np.asarray(np.linalg.norm(self.wrench[:, :3], axis=1))

    @property
    def magnitude_std(self) -> Array:
        """Standard deviation of the magnitude, N (n,), along the force."""
        if self.space is Space.PLANE:
            return self.point_force.magnitude_std
        force = self.wrench[:, :3]
        unit = force / np.maximum(np.linalg.norm(force, axis=1), 1e-300)[:, None]
        return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", unit, self.covariance[:, :3, :3], unit)))

    @property
    def intervals(self) -> tuple[Interval, ...]:
        """When something touched the tool."""
        return self.detection.intervals

    def time_of(self, sample: int) -> float:
        """Time (s) of a sample, its number at rest."""
        time = self.recording.time
        return float(sample) if time is None else float(time[min(sample, len(time) - 1)])

    def rows(self) -> list[tuple[str, ...]]:
        """Each interval: from, to, mean of each component and the largest magnitude, as text."""
        return [
            (
                f"{self.time_of(i.first):.3f}",
                f"{self.time_of(i.last):.3f}",
                *(f"{v:.3g}" for v in self.wrench[i.first : i.last].mean(axis=0)),
                f"{self.magnitude[i.first : i.last].max():.3g}",
                f"{i.p_value:.1g}",
            )
            for i in self.intervals
        ]

    def __str__(self) -> str:
        if not self.intervals:
            return "no contact found"
        return table(("from", "to", *self.names, "largest force", "p"), self.rows())


def compensate(
    fitted: Fit | StreamedFit | Calibration,
    recording: Recording,
    *,
    keep_zero: bool = False,
    tip_length: float | None = None,
    false_alarms: float = 0.01,
) -> Contact:
    """The contact wrench of a recording: what its readings hold beyond the fitted tool (22.13).

    A reading is G (tool - contact) + zero, so that contact = G^-1 (predicted - measured), predicted with the zero of
    this recording. The zero is where the tool is free (`detect`), unless `keep_zero` takes the calibration's; what
    follows of the parameters' covariance is counted about that zero, since a wrong weight moves the zero with it. A
    slow sensor's contact is left as slow as it is: undoing it would amplify the noise (`late`).
    `tip_length` (m) is where a planar contact acts; by default the rig's.
    Raises InputError when the channels differ or a signal is missing that the model needs.
    """
    known = (fitted if isinstance(fitted, Calibration) else Calibration.of(fitted)).lasting
    check_channels(known.model, (recording,))
    response = respond(known.model, recording, known.theta)
    gain, slopes = contact_gain_at(known.model, known.theta)
    biases = np.arange(len(known.model.biases))
    residual = recording.wrench - response.value
    found = detect(
        residual,
        recording.dt,
        floor=known.floor,
        remainder=known.remainder,
        zero=np.zeros(len(biases)) if keep_zero else None,
        false_alarms=false_alarms,
    )
    inverse = np.linalg.inv(gain)
    wrench = (residual - found.zero) @ inverse.T
    tangent = response.derivative
    if not keep_zero:
        tangent = tangent - tangent[found.free].mean(axis=0)
    # From reading = value(theta) + gain(theta) contact: d contact = -gain^-1 (d value + d gain contact).
    tangent = -np.einsum("ij,njk->nik", inverse, tangent + np.einsum("ijk,nj->nik", slopes, wrench))
    untold = np.abs(tangent[:, :, ~known.known]).max(axis=(0, 1), initial=0.0)
    tangent, covariance = tangent[:, :, known.known], known.covariance[np.ix_(known.known, known.known)]
    doubt = np.einsum("nik,kl,njl->nij", tangent, covariance, tangent, optimize=True)
    return Contact(
        recording=recording,
        calibration=known,
        detection=found,
        wrench=wrench,
        noise=inverse @ found.covariance @ inverse.T,
        doubt=doubt + inverse @ found.zero_covariance @ inverse.T,
        zero_shift=found.zero,
        late=lateness(known.model, known.theta),
        unknown=_unknown(known, untold),
        tip_length=_tip_length(recording, tip_length),
    )


def _unknown(known: Calibration, moved: Array) -> dict[str, float]:
    """Parameters that were never determined, and that this motion asks for."""
    names = [p.name for p, seen in zip(known.model.parameters, known.known, strict=True) if not seen]
    return {name: float(amount) for name, amount in zip(names, moved, strict=True) if amount > 0}


def _tip_length(recording: Recording, stated: float | None) -> float | None:
    return stated if stated is not None or recording.rig is None else recording.rig.tip_length
