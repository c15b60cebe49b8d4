# SPDX-License-Identifier: Apache-2.0
"""The simulated tactile sensor: true contacts in, what a skin would report out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.core.config import Config, param
from tactile_hand_ros.core.contact import Contacts, contact_frame
from tactile_hand_ros.core.rotations import quaternion_from_rotation, rotation_from_quaternion

Array = NDArray[np.float64]


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
    force_noise: float = param(
        0.0, "standard deviation of each force component", unit="N", live=True, ge=0.0
    )
    force_resolution: float = param(
        0.0, "smallest step of a force, 0 for continuous", unit="N", live=True, ge=0.0
    )
    latency: float = param(0.0, "age of a sample when it is published", unit="s", ge=0.0, le=1.0)
    dropout: float = param(
        0.0,
        "chance that a finger's sample is lost, so that its last is repeated",
        live=True,
        ge=0.0,
        le=1.0,
    )
    seed: int = param(1, "seed of noise and dropout", ge=0)


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
    """Samples true contacts with noise, resolution, latency and dropout, all from one seed."""

    def __init__(self, config: TactileSensorConfig, radii: Array) -> None:
        """Build the skin of fingertips with the given radii, shape (k,), m."""
        self._radii = np.asarray(radii, dtype=float)
        self.config = config
        self.reset()

    def configure(self, config: TactileSensorConfig) -> None:
        """Take other noise while running; seed, rate and latency stay."""
        self.config = config

    def reset(self) -> None:
        """Start anew, with the same seed."""
        self._random = np.random.default_rng(self.config.seed)
        self._sample = -1
        self._held: TactileReading | None = None
        self._waiting: deque[tuple[int, TactileReading]] = deque()

    def step(self, stamp: int, true: TactileReading) -> TactileReading:
        """Return what is published at a tick.

        Args:
            stamp: The tick, ns.
            true: True contacts at this tick.
        """
        sample = int(stamp * 1e-9 * self.config.rate + 1e-6)
        if sample != self._sample:
            self._sample = sample
            self._waiting.append((stamp, self._measure(true)))
        due = stamp - round(self.config.latency * 1e9)
        # The first sample stands in for what was before it.
        while self._held is None or (self._waiting and self._waiting[0][0] <= due):
            self._held = self._waiting.popleft()[1]
        return self._held

    def _measure(self, true: TactileReading) -> TactileReading:
        c, k = self.config, len(self._radii)
        # Drawn for every finger at every sample: one finger's luck leaves the others' alone.
        shift = c.location_noise * self._random.standard_normal((k, 3))
        force_noise = c.force_noise * self._random.standard_normal((k, 3))
        lost = self._random.random(k) < c.dropout
        positions, quaternions = true.positions, true.quaternions
        if c.location_noise > 0.0 or c.location_resolution > 0.0:
            positions, quaternions = self._displaced(true, shift)
        touching = np.isfinite(positions[:, :1])
        forces = np.where(touching, _rounded(true.forces + force_noise, c.force_resolution), 0.0)
        last = self._waiting[-1][1] if self._waiting else self._held
        if last is None or not lost.any():
            return TactileReading(positions.copy(), quaternions.copy(), forces)
        keep = lost[:, None]
        return TactileReading(
            np.where(keep, last.positions, positions),
            np.where(keep, last.quaternions, quaternions),
            np.where(keep, last.forces, forces),
        )

    def _displaced(self, true: TactileReading, shift: Array) -> tuple[Array, Array]:
        """Move each contact over its fingertip; point and normal stay those of the sphere (A2)."""
        normals = rotation_from_quaternion(true.quaternions)[:, :, 1]
        radii = self._radii[:, None]
        centres = true.positions - radii * normals
        arms = _rounded(radii * normals + shift, self.config.location_resolution)
        seen = arms / np.linalg.norm(arms, axis=1, keepdims=True)
        frames = np.array(
            [contact_frame(n) if np.isfinite(n[0]) else np.full((3, 3), np.nan) for n in seen]
        )
        return centres + radii * seen, quaternion_from_rotation(frames)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step > 0.0 else values
