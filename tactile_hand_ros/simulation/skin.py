# SPDX-License-Identifier: Apache-2.0
"""The simulated tactile sensor: turns true contacts into the report of a skin."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from tactile_hand_ros.compiled import Array, Row, Rows, compiled, row_of
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, contact_frame, in_contacts, in_palm
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.rotations import (
    Vector,
    quaternion_from_rotation,
    quaternions_of_rows,
    rotation_from_quaternion,
    rotation_from_vector,
    rows_of_quaternions,
)

if TYPE_CHECKING:  # only a wrong calibration needs the model
    from tactile_hand_ros.hand.hand import Hand


class VibrationConfig(Config):
    """Micro-vibration of the force at a sliding contact (Johansson and Westling 1987)."""

    gain: float = param(0.0, "rms force per speed of slow sliding", unit="N s/m", live=True, ge=0.0)
    limit: float = param(0.2, "rms force in the limit of fast sliding", unit="N", live=True, gt=0.0)
    low: float = param(60.0, "lower edge of the band", unit="Hz", gt=0.0)
    high: float = param(400.0, "upper edge of the band", unit="Hz", gt=0.0)


class CalibrationConfig(Config):
    """Errors of the hand's model, the same for all fingers; none by default.

    The plant has the true hand. All else works with the model, including the driver of the skin:
    it reports a contact on the fingertip of the model.
    """

    link_lengths: float = param(1.0, "true link lengths, relative to the URDF", ge=0.5, le=2.0)
    tip_radii: float = param(
        1.0, "true fingertip radii, relative to the hand's YAML", ge=0.5, le=2.0
    )
    skin_rotation: Vector = param(
        (0.0, 0.0, 0.0),
        "rotation vector of the reported contacts against the true ones, axes of the fingertip",
        unit="rad",
    )
    gravity_rotation: Vector = param(
        (0.0, 0.0, 0.0),
        "rotation vector of true gravity against that of the model, palm axes",
        unit="rad",
    )

    @property
    def is_right(self) -> bool:
        """Whether the model has no errors."""
        lengths = self.link_lengths == self.tip_radii == 1.0
        return lengths and not np.any([self.skin_rotation, self.gravity_rotation])


class TactileSensorConfig(Config):
    """Parameters of the tactile sensor."""

    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    calibration: CalibrationConfig = CalibrationConfig()
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
        0.0, "chance of a repeated sample, per finger", live=True, ge=0.0, le=1.0
    )
    faults: list[Literal["none", "off", "stuck", "wrong"]] = param(
        [],
        "fault of each finger, empty for none: off reports no contact, stuck repeats its last "
        "sample, wrong shows three times the force",
        live=True,
    )
    axes: Literal["all", "normal"] = param(
        "all", "components of a force that it measures; the others are NaN"
    )
    seed: int = param(1, "seed of everything random", ge=0)

    @field_validator("faults", mode="before")
    @classmethod
    def _off_is_a_word(cls, given: Any) -> Any:
        """Take False for off, as YAML reads it."""
        return ["off" if x is False else x for x in given] if isinstance(given, list) else given

    def check_faults(self, fingers: int) -> None:
        """Check that each of k fingers has a fault, or none has.

        Raises:
            ConfigurationError: Otherwise.
        """
        if len(self.faults) not in (0, fingers):
            raise ConfigurationError(
                f"faults = {self.faults}: expected one of none, off, stuck and wrong for each of "
                f"{fingers} fingers, or an empty list"
            )


class TactileReading(NamedTuple):
    """A report of the skin, in the form of topics.

    Attributes:
        positions: Contact points in the palm frame, shape (k, 3), m; NaN without a contact.
        quaternions: Contact frames C_i in the palm frame (x, y, z, w), shape (k, 4).
        forces: Forces on the object in C_i, shape (k, 3), N; NaN where a skin does not measure.
    """

    positions: Array
    quaternions: Array
    forces: Array

    @property
    def contacts(self) -> Contacts:
        """Contact points and frames."""
        return Contacts.from_poses(self.positions, self.quaternions)


def miscalibrated(
    config: CalibrationConfig, model: Hand, theta: Array, true: TactileReading
) -> TactileReading:
    """Return contacts p = p_f + r n and forces, with p_f and r of the model and a turned n.

    Args:
        config: The errors.
        model: The hand of the controllers.
        theta: Joint angles, shape (m,), rad.
        true: The true contacts.
    """
    centers, tips = model.tip_positions(theta), model.tip_rotations(theta)
    turns = tips @ rotation_from_vector(config.skin_rotation) @ np.swapaxes(tips, 1, 2)
    frames = turns @ rotation_from_quaternion(true.quaternions)
    normals = frames[:, :, 1]
    seen = np.array([contact_frame(n) for n in normals])
    forces = np.swapaxes(seen, 1, 2) @ frames @ true.forces[:, :, None]
    touches = np.isfinite(true.positions[:, :1])
    return TactileReading(
        centers + model.radii[:, None] * normals,
        quaternion_from_rotation(seen),
        np.where(touches, forces[:, :, 0], 0.0),
    )


_WRONG = 3.0  # factor of the forces of a wrong finger; measured and true ones differ clearly

_MEMORY = np.dtype(
    [
        ("bias", np.float64, 3),  # drifted zero of the force
        ("measured", np.float64, 3),  # force after the bandwidth; NaN: none yet
        ("arm", np.float64, 3),  # smoothed contact from the fingertip's center; NaN: none
    ]
)


class TactileSensor:
    """Samples true contacts like a skin, with one seed.

    A force passes these stages: vibration while the contact slides, bandwidth, drift of the zero,
    white noise, resolution, dropout and latency. A skin that is faster than the ticks samples the
    vibration at its own rate, and the true contacts of a tick hold since the last tick.
    """

    def __init__(
        self, config: TactileSensorConfig, radii: Array, model: Hand | None = None
    ) -> None:
        """Build the skin of fingertips with radii, shape (k,), m.

        The model of the controllers is only needed with a wrong calibration.

        Raises:
            ConfigurationError: If the faults do not fit the number of fingers.
        """
        self._radii = np.asarray(radii, dtype=float)
        self._model = None if config.calibration.is_right else model
        self._at_rest = np.zeros(len(self._radii))
        self.configure(config)
        self.reset()

    def configure(self, config: TactileSensorConfig) -> None:
        """Change noise and faults while running; seed, rate, latency and filters stay.

        Raises:
            ConfigurationError: If the faults do not fit the number of fingers.
        """
        config.check_faults(len(self._radii))
        self.config = config
        self._numbers = row_of(config)

    def reset(self) -> None:
        """Start again, with the same seed."""
        c, k = self.config, len(self._radii)
        self._random = np.random.default_rng(c.seed)
        self._sample = -1
        self._held: TactileReading | None = None
        self._waiting: deque[tuple[int, TactileReading]] = deque()
        self._memory: Rows = np.zeros(k, _MEMORY)
        self._memory["measured"] = self._memory["arm"] = np.nan
        self._unread = np.random.default_rng([c.seed, 1])  # of samples between ticks
        band = c.vibration.low, c.vibration.high
        self._rumble = BandNoise((k, 3), *band, c.rate, c.bandwidth)

    def step(
        self,
        stamp: int,
        true: TactileReading,
        sliding: Array | None = None,
        theta: Array | None = None,
    ) -> TactileReading:
        """Return the published report of a tick.

        Args:
            stamp: The tick, ns.
            true: True contacts at this tick.
            sliding: Sliding speeds of the contacts, shape (k,), m/s; none slides by default.
            theta: Joint angles, shape (m,), rad; only needed with a wrong calibration.
        """
        if self._model is not None and theta is not None:
            true = miscalibrated(self.config.calibration, self._model, theta, true)
        sample = int(stamp * 1e-9 * self.config.rate + 1e-6)
        if sample != self._sample:
            count = 1 if self._sample < 0 else sample - self._sample
            elapsed = (sample - self._sample) / self.config.rate
            self._sample = sample
            self._waiting.append((stamp, self._measure(true, sliding, elapsed, count)))
        due = stamp - round(self.config.latency * 1e9)
        # The first sample replaces those before it.
        while self._held is None or (self._waiting and self._waiting[0][0] <= due):
            self._held = self._waiting.popleft()[1]
        return self._held

    def _measure(
        self, true: TactileReading, sliding: Array | None, elapsed: float, count: int
    ) -> TactileReading:
        """Return the newest of a number of samples."""
        k = len(self._radii)
        # Drawn for every finger at every sample, so that fingers do not affect each other.
        white = self._random.standard_normal((4, k, 3))
        draws = self._random.random(k)
        if self.config.vibration.gain > 0.0:
            unread = max(0, min(count, math.ceil(self.config.rate)) - 1)  # of a second at most
            samples = white[1:2]
            if unread:
                earlier = self._unread.standard_normal((unread, k, 3))
                samples = np.concatenate((earlier, samples))
            white[1] = self._rumble.step(samples)
        speeds = self._at_rest if sliding is None else sliding
        skin = self._memory, self._numbers, self._radii
        measured = _measured(*skin, *true, speeds, white, elapsed)
        reading = TactileReading(*measured)
        last = self._waiting[-1][1] if self._waiting else self._held
        if self.config.faults:
            reading = _spoiled(np.array(self.config.faults), last, reading)
        if last is not None and self.config.dropout > 0.0:
            reading = _kept(draws < self.config.dropout, last, reading)
        if self.config.axes == "normal":
            reading.forces[:, ::2] = np.nan
        return reading


def _kept(chosen: NDArray[np.bool_], last: TactileReading, new: TactileReading) -> TactileReading:
    """Return a new sample in which the chosen fingers, a mask of shape (k,), repeat the last."""
    pairs = zip(last, new, strict=True)
    return TactileReading(*(np.where(chosen[:, None], *pair) for pair in pairs))


def _spoiled(
    faults: NDArray[np.str_], last: TactileReading | None, new: TactileReading
) -> TactileReading:
    """Return a new sample with the faults of the fingers, shape (k,)."""
    off, wrong = faults == "off", faults == "wrong"
    spoiled = new._replace(
        positions=np.where(off[:, None], np.nan, new.positions),
        forces=np.where(off, 0.0, np.where(wrong, _WRONG, 1.0))[:, None] * new.forces,
    )
    return spoiled if last is None else _kept(faults == "stuck", last, spoiled)


@compiled
def _measured(
    memory: Rows,
    config: Rows,
    radii: Array,
    positions: Array,
    quaternions: Array,
    forces: Array,
    sliding: Array,
    noise: Array,
    elapsed: float,
) -> tuple[Array, Array, Array]:
    """Return positions, quaternions and forces of a sample, `elapsed` seconds after the last one.

    The noise, of unit variance, is for location, vibration, drift and force, shape (4, k, 3).
    """
    c = config[0]
    positions, quaternions, measured = positions.copy(), quaternions.copy(), forces.copy()
    gain, limit = c["vibration.gain"], c["vibration.limit"]
    for i in range(len(radii)):
        rms = limit * (1.0 - math.exp(-gain / limit * sliding[i]))
        measured[i] += rms * noise[1, i]
    is_displaced = max(c["location_noise"], c["location_resolution"], c["location_bandwidth"]) > 0.0
    if is_displaced or c["bandwidth"] > 0.0 or c["bias_drift"] > 0.0:
        # In one frame, since the reported contact frame moves.
        measured = in_palm(rows_of_quaternions(quaternions).reshape(-1, 3, 3), measured, 1.0)
        _follow(memory, c, measured, noise[2], elapsed)
        if is_displaced:
            _displace(memory, c, radii, positions, quaternions, noise[0], elapsed)
        seen = rows_of_quaternions(quaternions).reshape(-1, 3, 3)
        measured = in_contacts(seen, measured)
    for i in range(len(radii)):
        touches = math.isfinite(positions[i, 0])
        for axis in range(3):
            force = measured[i, axis] + c["force_noise"] * noise[3, i, axis]
            measured[i, axis] = _rounded(force, c["force_resolution"]) if touches else 0.0
    return positions, quaternions, measured


@compiled
def _follow(memory: Rows, c: Row, forces: Array, white: Array, elapsed: float) -> None:
    """Apply bandwidth and drift to forces in palm axes; without a contact, NaN, they rest."""
    fraction, walk = 1.0, c["bias_drift"] * math.sqrt(elapsed)
    if c["bandwidth"] > 0.0:
        fraction = -math.expm1(-2.0 * math.pi * c["bandwidth"] * elapsed)
    for i in range(len(memory)):
        before, bias = memory[i]["measured"], memory[i]["bias"]
        bias += walk * white[i]
        if not math.isfinite(forces[i, 0]):
            before[:] = 0.0
            continue
        if math.isfinite(before[0]):
            forces[i] = before + fraction * (forces[i] - before)
        before[:] = forces[i]
        forces[i] += bias


@compiled
def _displace(
    memory: Rows,
    c: Row,
    radii: Array,
    positions: Array,
    quaternions: Array,
    white: Array,
    elapsed: float,
) -> None:
    """Move each contact over its fingertip; point and normal stay those of the sphere (A2)."""
    frames, follow = rows_of_quaternions(quaternions), c["location_bandwidth"] > 0.0
    fraction = 1.0 - math.exp(-2.0 * math.pi * c["location_bandwidth"] * elapsed)
    for i in range(len(radii)):
        normal, arm = frames[i, 1::3], np.empty(3)
        for axis in range(3):
            shifted = radii[i] * normal[axis] + c["location_noise"] * white[i, axis]
            arm[axis] = _rounded(shifted, c["location_resolution"])
            before = memory[i]["arm"][axis]
            if follow and math.isfinite(before):  # a new contact appears immediately
                arm[axis] = before + fraction * (arm[axis] - before)
            if follow:
                memory[i]["arm"][axis] = arm[axis]
        center = positions[i] - radii[i] * normal
        seen = arm / math.sqrt(arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2])
        positions[i] = center + radii[i] * seen
        frames[i] = contact_frame(seen).reshape(9)
    quaternions[:] = quaternions_of_rows(frames)


@compiled
def _rounded(value: float, step: float) -> float:
    return np.rint(value / step) * step if step > 0.0 else value


class BandNoise:
    """Gaussian noise of unit variance between two frequencies, sample by sample.

    White noise through a first-order high-pass after a first-order low-pass; the variance of the
    result is that of its impulse response.
    """

    def __init__(
        self, shape: tuple[int, int], low: float, high: float, rate: float, bandwidth: float
    ) -> None:
        """Start silently, for noise of a shape (n, m) from `low` to `high`, Hz, at a rate in Hz.

        The bandwidth is the corner frequency of the next low-pass, 0 for none, Hz.
        """
        nyquist = 0.5 * rate
        self._pass = 1.0 - math.exp(-2.0 * math.pi * min(high, nyquist) / rate)
        self._follow = 1.0 - math.exp(-2.0 * math.pi * min(low, 0.9 * nyquist) / rate)
        self._keep = math.exp(-2.0 * math.pi * bandwidth / rate) if bandwidth > 0.0 else 0.0
        a, b = 1.0 - self._pass, 1.0 - self._follow
        self._scale = math.sqrt(0.5 * (1.0 + a) * (1.0 + b) * (1.0 - a * b)) / (self._pass * b)
        self._smooth, self._slow = np.zeros(shape), np.zeros(shape)

    def step(self, white: Array) -> Array:
        """Return the mean of the next samples, weighted by the low-pass of the bandwidth.

        Held for their time, this mean has the same effect on the low-pass as the samples. Without
        a bandwidth it is the newest sample.

        Args:
            white: White noise of unit variance, shape (n, *shape), oldest first.
        """
        memory = self._smooth, self._slow
        return self._scale * _filtered(*memory, self._pass, self._follow, self._keep, white)


@compiled
def _filtered(
    smooth: Array, slow: Array, passes: float, follows: float, keep: float, white: Array
) -> Array:
    """Move a low-pass and a slower one behind it on; return the mean of their difference."""
    total, weight = np.zeros_like(smooth), 0.0
    for i in range(len(white)):
        smooth += passes * (white[i] - smooth)
        slow += follows * (smooth - slow)
        total = keep * total + (smooth - slow)
        weight = keep * weight + 1.0
    return total / weight
