"""Logs of poses at rest by a simulator of their own: a tool turned from pose to pose about the sensor's origin.

The wrench is that of a rigid body by Newton's and Euler's equations on rotations that are differentiated numerically,
so that no equation of a model is shared.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.80665])
FINE = 20
"""Steps of the simulation to a sample: differences of rotations are exact to 1e-4 of the largest acceleration then."""


def flicker(rng: np.random.Generator, n: int, level: float) -> Array:
    """Noise (n,) with the one-sided spectrum level² / f, f in cycles a sample, down to 1 / (4 n)."""
    size = 4 * n
    f = np.fft.rfftfreq(size)[1:]
    amplitude = level / np.sqrt(f) * np.sqrt(size / 4)
    lines = amplitude * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    return np.asarray(np.fft.irfft(np.concatenate([[0], lines]), n=size)[:n] * np.sqrt(1.0))


@dataclass(frozen=True, kw_only=True)
class DwellLog:
    """What somebody logs who takes poses at rest.

    dwell, transition  s; a transition of 0 s is not logged: the next pose begins at the next sample
    gap        s between the last sample of a pose and the first of the next, beside the step; transitions of 0 s
    white, flicker     std of the readings' white noise, N, and level of their 1 / f noise; torques have a twentieth
    pose_noise, dither rad, of the logged orientation, and of the sensor itself at 1.3 Hz
    settling   N by which the readings are off after a stop, and s within which that falls to 1 / e
    drift      N by which the zero of fz warms up, exponentially within the log
    push       N by which a hand pushes in transitions
    drag       N m s: of the torque against the rotation
    lag        s of a low-pass filter in the sensor
    """

    seed: int = 0
    poses: int = 12
    rate: float = 25.0
    dwell: float = 6.0
    transition: float = 0.0
    gap: float = 0.0
    largest_turn: float = np.pi
    white: float = 0.1
    flicker: float = 0.0
    pose_noise: float = 0.0
    dither: float = 0.0
    settling: tuple[float, float] = (0.0, 1.0)
    drift: float = 0.0
    push: float = 0.0
    drag: float = 0.0
    lag: float = 0.0
    mass: float = 0.9
    centre: tuple[float, float, float] = (0.005, -0.010, 0.060)
    inertia: tuple[float, float, float] = (0.004, 0.005, 0.002)
    bias: tuple[float, ...] = (0.3, -0.5, 0.8, 0.02, -0.03, 0.01)
    dwells: tuple[float, ...] = field(default=())

    def columns(self) -> dict[str, Array]:
        """Columns of a recording, and `resting`, 1 in the rows of a dwell."""
        rng = np.random.default_rng(self.seed)
        step = 1 / self.rate
        goals = self._goals(rng)
        seconds = self.dwells or (self.dwell,) * self.poses
        rotations, stamps, resting, pose = [], [], [], []
        now = 0.0
        for number, goal in enumerate(goals):
            if number and self.transition:
                count = max(round(self.transition / step), 1)
                x = np.arange(1, count * FINE) / (count * FINE)
                vector = (goals[number - 1].inv() * goal).as_rotvec()
                path = goals[number - 1] * Rotation.from_rotvec(np.outer(x**3 * (10 - 15 * x + 6 * x**2), vector))
                rotations.append(path)
                stamps.append(now + step / FINE * np.arange(len(path)))
                resting.append(np.zeros(len(path)))
                pose.append(np.full(len(path), np.nan))
                now += step / FINE * len(path)
            count = round(seconds[number] / step) * FINE
            rotations.append(Rotation.concatenate([goal] * count))
            stamps.append(now + step / FINE * np.arange(count))
            resting.append(np.ones(count))
            pose.append(np.full(count, float(number)))
            now += step / FINE * count + (self.gap if number < self.poses - 1 else 0.0)
        time, rest = np.concatenate(stamps), np.concatenate(resting)
        turn = Rotation.concatenate(rotations)
        if self.dither:
            angle = self.dither * np.sin(2 * np.pi * 1.3 * time)
            turn = turn * Rotation.from_rotvec(np.outer(angle, [1.0, 0.5, 0.2]))
        wrench = self._wrench(turn, step / FINE, np.concatenate(pose))
        every = slice(0, None, FINE)
        wrench, time, rest, turn = wrench[every].copy(), time[every], rest[every], turn[every]
        n = len(time)
        wrench[:, 2] += self.drift * (1 - np.exp(-3 * time / time[-1])) / (1 - np.exp(-3))
        starts = np.concatenate([[0], np.flatnonzero(np.diff(np.concatenate(pose)[every], prepend=0.0) != 0)])
        last = np.maximum.accumulate(np.where(np.isin(np.arange(n), starts), time, -np.inf))
        transient = self.settling[0] * np.exp(-(time - last) / self.settling[1]) * rest
        wrench[:, :3] += transient[:, None] * np.array([1.0, -0.7, 0.5])
        size = np.array([1, 1, 1, 0.05, 0.05, 0.05])
        wrench += self.white * size * rng.standard_normal(wrench.shape)
        if self.flicker:
            wrench += size * np.stack([flicker(rng, n, self.flicker) for _ in range(6)], axis=1)
        seen = turn * Rotation.from_rotvec(self.pose_noise / np.sqrt(3) * rng.standard_normal((n, 3)))
        names = ("fx", "fy", "fz", "tx", "ty", "tz")
        columns = {"time": time} | dict(zip(("qx", "qy", "qz", "qw"), seen.as_quat().T, strict=True))
        return columns | dict(zip(names, wrench.T, strict=True)) | {"resting": rest}

    def _goals(self, rng: np.random.Generator) -> list[Rotation]:
        """Orientations, each within `largest_turn` of the one before."""
        goals = [Rotation.from_rotvec([0.3, 0.2, 0.1])]
        while len(goals) < self.poses:
            turn = Rotation.random(random_state=rng).as_rotvec()
            size = float(np.linalg.norm(turn))
            goals.append(goals[-1] * Rotation.from_rotvec(turn * min(1.0, self.largest_turn / size)))
        return goals

    def _wrench(self, turn: Rotation, step: float, pose: Array) -> Array:
        """The wrench (n, 6) that the sensor exerts on the tool, sensor axes, without noise."""
        n = len(turn)
        omega = np.zeros((n, 3))
        moved = (turn[:-1].inv() * turn[1:]).as_rotvec() / step
        if self.transition or self.dither:
            omega[1:-1] = (moved[1:] + moved[:-1]) / 2
        alpha = np.gradient(omega, step, axis=0)
        centre, inertia = np.array(self.centre), np.array(self.inertia)
        down = turn.apply(GRAVITY, inverse=True)
        acceleration = np.cross(alpha, centre) + np.cross(omega, np.cross(omega, centre))
        force = self.mass * (acceleration - down)
        torque = np.cross(centre, force) + inertia * alpha + np.cross(omega, inertia * omega)
        torque = torque + self.drag * omega
        if self.push:
            moving = np.isnan(pose).astype(float)
            time = np.arange(n) * step
            hand = np.stack([np.sin(7.1 * time) + 1, np.cos(3.3 * time), np.sin(5.3 * time + 1) - 0.5], axis=1)
            force = force + self.push * hand * moving[:, None]
            torque = torque + 0.1 * self.push * np.roll(hand, 1, axis=1) * moving[:, None]
        wrench = np.concatenate([force, torque], axis=1) + np.array(self.bias)
        if self.lag:
            from scipy.signal import lfilter

            gain = step / (self.lag + step)
            start = wrench[:1] * (1 - gain)
            wrench = lfilter([gain], [1, gain - 1], wrench, axis=0, zi=start)[0]
        return np.asarray(wrench)
