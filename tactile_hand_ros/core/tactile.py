# SPDX-License-Identifier: Apache-2.0
"""The simulated tactile sensor: true contacts in, what a skin would report out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.contact import Contacts, contact_frame
from tactile_hand_ros.core.rotations import quaternion_from_rotation, rotation_from_quaternion

Array = NDArray[np.float64]


class VibrationConfig(Config):
    """Micro-vibration that a skin picks up while a contact slides (Johansson and Westling 1987)."""

    gain: float = param(
        0.0, "rms force per sliding speed, for slow sliding", unit="N s/m", live=True, ge=0.0
    )
    limit: float = param(0.2, "rms force that fast sliding tends to", unit="N", live=True, gt=0.0)
    low: float = param(60.0, "lower edge of the band", unit="Hz", gt=0.0)
    high: float = param(400.0, "upper edge of the band", unit="Hz", gt=0.0)


class TactileSensorConfig(Config):
    """Parameters of the tactile sensor."""

    hand: str = param("paper", "hand by name or YAML file")
    rate: float = param(
        10000.0, "samples per second; between samples the last one is repeated", unit="Hz", gt=0.0
    )
    location_noise: float = param(
        0.0, "standard deviation of the contact location", unit="m", live=True, ge=0.0
    )
    location_resolution: float = param(
        0.0, "spacing of the taxels, 0 for continuous", unit="m", live=True, ge=0.0
    )
    location_bandwidth: float = param(
        0.0, "corner frequency of the contact location, 0 for none", unit="Hz", ge=0.0
    )
    force_noise: float = param(
        0.0, "standard deviation of each force component", unit="N", live=True, ge=0.0
    )
    force_resolution: float = param(
        0.0, "smallest step of a force, 0 for continuous", unit="N", live=True, ge=0.0
    )
    bandwidth: float = param(
        0.0, "corner frequency of the skin's first-order response, 0 for none", unit="Hz", ge=0.0
    )
    bias_drift: float = param(
        0.0, "random walk of each force's zero, per square root of time", unit="N/sqrt(s)", ge=0.0
    )
    vibration: VibrationConfig = VibrationConfig()
    latency: float = param(0.0, "age of a sample when it is published", unit="s", ge=0.0, le=1.0)
    dropout: float = param(
        0.0,
        "chance that a finger's sample is lost, so that its last is repeated",
        live=True,
        ge=0.0,
        le=1.0,
    )
    seed: int = param(1, "seed of everything random", ge=0)


@dataclass(frozen=True)
class TactileReading:
    """What the skin reports, as it travels on topics.

    Attributes:
        positions: Contact points in the palm frame, shape (k, 3), m; NaN where there is none.
        quaternions: Contact frames C_i in the palm frame (x, y, z, w), shape (k, 4).
        forces: Forces on the object in C_i, shape (k, 3), N.
    """

    positions: Array
    quaternions: Array
    forces: Array

    @property
    def contacts(self) -> Contacts:
        """Contact points and frames."""
        return Contacts.from_poses(self.positions, self.quaternions)


class TactileSensor:
    """Samples true contacts as a skin would, all from one seed.

    A force passes, in this order: vibration while the contact slides, the skin's bandwidth, the
    drifting zero, white noise, resolution, dropout and latency.
    """

    def __init__(self, config: TactileSensorConfig, radii: Array) -> None:
        """Build the skin of fingertips with the given radii, shape (k,), m."""
        self._radii = np.asarray(radii, dtype=float)
        self.config = config
        self.reset()

    def configure(self, config: TactileSensorConfig) -> None:
        """Take other noise while running; seed, rate, latency and filters stay."""
        self.config = config

    def reset(self) -> None:
        """Start anew, with the same seed."""
        c, k = self.config, len(self._radii)
        self._random = np.random.default_rng(c.seed)
        self._sample = -1
        self._held: TactileReading | None = None
        self._waiting: deque[tuple[int, TactileReading]] = deque()
        self._bias = np.zeros((k, 3))
        self._felt: Array | None = None
        self._arms = np.full((k, 3), np.nan)
        self._rumble = BandNoise((k, 3), c.vibration.low, c.vibration.high, c.rate)

    def step(
        self, stamp: int, true: TactileReading, sliding: Array | None = None
    ) -> TactileReading:
        """Return what is published at a tick.

        Args:
            stamp: The tick, ns.
            true: True contacts at this tick.
            sliding: Sliding speeds of the contacts, shape (k,), m/s; none slides by default.
        """
        sample = int(stamp * 1e-9 * self.config.rate + 1e-6)
        if sample != self._sample:
            elapsed = (sample - self._sample) / self.config.rate
            self._sample = sample
            self._waiting.append((stamp, self._measure(true, sliding, elapsed)))
        due = stamp - round(self.config.latency * 1e9)
        # The first sample stands in for what was before it.
        while self._held is None or (self._waiting and self._waiting[0][0] <= due):
            self._held = self._waiting.popleft()[1]
        return self._held

    def _measure(
        self, true: TactileReading, sliding: Array | None, elapsed: float
    ) -> TactileReading:
        c, k = self.config, len(self._radii)
        # Drawn for every finger at every sample: one finger's luck leaves the others' alone.
        shift, *white = self._random.standard_normal((4, k, 3))
        lost = self._random.random(k) < c.dropout
        positions, quaternions = true.positions, true.quaternions
        if c.location_noise > 0.0 or c.location_resolution > 0.0:
            positions, quaternions = self._displaced(true, c.location_noise * shift, elapsed)
        touching = np.isfinite(positions[:, :1])
        felt = self._feel(true.forces, sliding, white, elapsed)
        forces = np.where(touching, _rounded(felt, c.force_resolution), 0.0)
        last = self._waiting[-1][1] if self._waiting else self._held
        if last is None or not lost.any():
            return TactileReading(positions.copy(), quaternions.copy(), forces)
        keep = lost[:, None]
        return TactileReading(
            np.where(keep, last.positions, positions),
            np.where(keep, last.quaternions, quaternions),
            np.where(keep, last.forces, forces),
        )

    def _feel(
        self, forces: Array, sliding: Array | None, white: list[Array], elapsed: float
    ) -> Array:
        """Return the forces after vibration, bandwidth, drift and noise."""
        c = self.config
        if c.vibration.gain > 0.0:
            speed = np.zeros(len(forces)) if sliding is None else sliding
            limit = c.vibration.limit
            rms = limit * (1.0 - np.exp(-c.vibration.gain / limit * speed))
            forces = forces + rms[:, None] * self._rumble.step(white[0])
        if c.bandwidth > 0.0:
            share = 1.0 - math.exp(-2.0 * math.pi * c.bandwidth * elapsed)
            before = forces if self._felt is None else self._felt
            self._felt = forces = before + share * (forces - before)
        if c.bias_drift > 0.0:
            self._bias += c.bias_drift * math.sqrt(elapsed) * white[1]
            forces = forces + self._bias
        return np.asarray(forces + c.force_noise * white[2])

    def _settled(self, arms: Array, elapsed: float) -> Array:
        """Low-pass where on the fingertips the contacts are; new contacts show at once."""
        bandwidth = self.config.location_bandwidth
        if bandwidth > 0.0:
            share = 1.0 - math.exp(-2.0 * math.pi * bandwidth * elapsed)
            before = np.where(np.isfinite(self._arms), self._arms, arms)
            arms = before + share * (arms - before)
            self._arms = arms
        return arms

    def _displaced(self, true: TactileReading, shift: Array, elapsed: float) -> tuple[Array, Array]:
        """Move each contact over its fingertip; point and normal stay those of the sphere (A2)."""
        normals = rotation_from_quaternion(true.quaternions)[:, :, 1]
        radii = self._radii[:, None]
        centres = true.positions - radii * normals
        arms = _rounded(radii * normals + shift, self.config.location_resolution)
        arms = self._settled(arms, elapsed)
        seen = arms / np.linalg.norm(arms, axis=1, keepdims=True)
        frames = np.array(
            [contact_frame(n) if np.isfinite(n[0]) else np.full((3, 3), np.nan) for n in seen]
        )
        return centres + radii * seen, quaternion_from_rotation(frames)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step > 0.0 else values


class BandNoise:
    """Gaussian noise of unit variance between two frequencies, sample by sample.

    White noise through a first-order high-pass after a first-order low-pass; the variance of the
    result is that of its impulse response.
    """

    def __init__(self, shape: tuple[int, ...], low: float, high: float, rate: float) -> None:
        """Start at rest; frequencies above half the rate count as half the rate."""
        nyquist = 0.5 * rate
        self._pass = 1.0 - math.exp(-2.0 * math.pi * min(high, nyquist) / rate)
        self._follow = 1.0 - math.exp(-2.0 * math.pi * min(low, 0.9 * nyquist) / rate)
        self._smooth, self._slow = np.zeros(1), np.zeros(1)
        impulse = [float(self._filter(np.array([float(i == 0)]))[0]) for i in range(2000)]
        self._scale = 1.0 / math.sqrt(sum(x * x for x in impulse))
        self._smooth, self._slow = np.zeros(shape), np.zeros(shape)

    def step(self, white: Array) -> Array:
        """Return the next sample for white noise of unit variance of the same shape."""
        return self._scale * self._filter(white)

    def _filter(self, white: Array) -> Array:
        self._smooth = self._smooth + self._pass * (white - self._smooth)
        self._slow = self._slow + self._follow * (self._smooth - self._slow)
        return self._smooth - self._slow
