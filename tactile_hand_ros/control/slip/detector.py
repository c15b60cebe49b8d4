# SPDX-License-Identifier: Apache-2.0
"""Slip detection, from the micro-vibration of the force at a sliding contact."""

from __future__ import annotations

import enum
import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, Row, Rows, compiled, row_of
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.rotations import dot

# Largest gain of the innovation over frequency against its mean, at even times: 2^4 / (1 + 4 + 1)
_OVERLAP = 16.0 / 6.0
_SAMPLE_LIMIT = 0.25  # largest contribution of a sample, as a fraction of the threshold
_RELEASE = 0.75  # fraction of the threshold at which a slip stops
_BOUND = 3.0  # times the noise: largest power of a sample while the noise is learned
# Correct that bound, for powers with one and with two degrees of freedom.
_UNBIASED_ONE = 1.0 / (
    math.erf(math.sqrt(0.5 * _BOUND))
    - math.sqrt(2.0 * _BOUND / math.pi) * math.exp(-0.5 * _BOUND)
    + _BOUND * math.erfc(math.sqrt(0.5 * _BOUND))
)
_UNBIASED = 1.0 / (1.0 - math.exp(-_BOUND))
_LATE = 3.0  # ticks, largest delay of a command
_SURE = 3.0  # standard deviations at which a normal force counts as a contact
_COURSE = 0.01  # s, time constant of the rate of a force
_GAP = 2.5  # times the sample period; a longer gap restarts the differences
_SILENCE = 5.0  # times the sample period after which evidence expires
_RATIO = 9.0  # power of the vibration relative to noise that the test expects
_SETTLING = 0.05  # s after touching without a report
_PATIENCE = 0.3  # s; a longer slip is learned as noise
_LEARNING = 1.0  # s, time constant of the learned noise

LONGEST = 0.02
"""The longest time that a pause between ticks counts [s]."""


class SlipDetectorConfig(Config):
    """Parameters of the slip detector."""

    noise: float = param(0.02, "noise of a force until it is learned", unit="N", live=True, gt=0.0)
    minimum_noise: float = param(
        0.002, "vibration below this is not slip", unit="N", live=True, gt=0.0
    )
    relative_noise: float = param(0.002, "the same, per normal force", live=True, ge=0.0)
    false_alarm_time: float = param(
        3600.0,
        "minimum mean time between false alarms of a contact that sticks; with a longer time slip "
        "is detected later",
        unit="s",
        live=True,
        ge=1.0,
    )


class ContactState(enum.IntEnum):
    """State of a contact; UNKNOWN does not mean that it sticks."""

    UNKNOWN = 0
    STICK = 1
    SLIP = 2


_MEMORY = np.dtype(
    [
        ("state", np.int64),  # ContactState
        ("evidence", np.float64),  # sum of log-likelihood ratios
        ("threshold", np.float64),  # of the evidence
        ("agrees", np.bool_),
        ("variance", np.float64),  # of a force, per axis
        ("pressed", np.float64, 3),  # force by the joint torques, palm axes
        ("pressing", np.float64, 3),  # change of it from sample to sample
        ("shaking", np.float64),  # usual power of its innovation, N^2
        ("excess", np.float64),  # of the newest innovation over that, N^2
        ("last", np.float64, 3),  # force, palm axes; NaN where there was none
        ("change", np.float64, 3),  # of it from sample to sample
        ("rate", np.float64, 3),  # of it, smoothed, N/s
        ("since", np.float64),  # the last sample, s
        ("spacing", np.float64),  # of the last two samples, s; 0: unknown
        ("period", np.float64),  # the same, also after a gap
        ("touched_for", np.float64),
        ("slipped_for", np.float64),
    ],
    align=True,
)


class SlipDetector:
    """Applies Page's cumulative sum test to fast force changes at each contact.

    Sticking forces are extrapolated from the last two samples. With q the time since the last one
    per time between the two, the innovation and its covariance are

        r = f_t - f_(t-1) - q (f_(t-1) - f_(t-2)),    R = (1 + (1 + q)^2 + q^2) v I + j j^T,

    across the direction of the internal force, with the learned noise v of the skin and the jitter
    j = 3 f' dt of commands that are up to three ticks late. The test sums the log-likelihood ratio
    of rho R against R,

        L = (1 - 1/rho) r^T R^-1 r / 2 - ln rho,

    restarts at zero when the sum is negative, and reports slip above h. Independent innovations
    have a mean of at least exp(h) samples between false alarms. Noise that alternates
    has 16 / 6 of the mean power, which scales h. A step of the load changes up to three
    innovations, so each counts for h / 4 at most. See docs/explanation/slip.md.

    Torques shake the grasp, too, in steps of an encoder above all. Forces u that balance them at
    the tips have innovations of their own. The largest of them at any contact is no evidence, as
    far as it exceeds the usual one: r^T r is less by max(0, r_u^T r_u - 3 s), with the mean s of
    that power, in which noise of measured torques counts.

    With the normal force alone, r is one number, and half of ln rho is subtracted.

    Source: Page, Continuous inspection schemes, 1954.
    """

    def __init__(self, config: SlipDetectorConfig, contacts: int) -> None:
        """Start without samples of k contacts."""
        self._memory: Rows = np.zeros(contacts, _MEMORY)
        self.configure(config)
        self.reset()

    def configure(self, config: SlipDetectorConfig) -> None:
        """Change the parameters; the memory of the contacts stays."""
        self._noise = config.noise
        self._config = row_of(config)

    def reset(self) -> None:
        """Forget everything."""
        self._memory[:] = np.zeros((), _MEMORY)
        self._memory["variance"] = self._noise**2
        self._memory["last"] = self._memory["change"] = np.nan
        self._memory["pressed"] = self._memory["pressing"] = np.nan
        self._memory["threshold"] = 1.0
        self._freedoms = 2

    @property
    def state(self) -> NDArray[np.int64]:
        """`ContactState` of each contact, shape (k,)."""
        return self._memory["state"].copy()

    @property
    def likelihood(self) -> Array:
        """Evidence for slip against its threshold, 0 to 1, shape (k,)."""
        return np.asarray(np.minimum(self._memory["evidence"] / self._memory["threshold"], 1.0))

    @property
    def agrees(self) -> NDArray[np.bool_]:
        """Whether the newest sample of each contact is evidence for slip, shape (k,)."""
        return self._memory["agrees"].copy()

    def step(
        self,
        forces: Array,
        normals: Array,
        internal: Array,
        fresh: NDArray[np.bool_],
        dt: float,
        freedoms: int = 2,
        pressed: Array | None = None,
    ) -> NDArray[np.int64]:
        """Return the `ContactState` of each contact after a tick, shape (k,).

        Args:
            forces: Measured forces on the object, palm axes, shape (k, 3), N; NaN: none.
            normals: Contact normals into the object, palm axes, shape (k, 3).
            internal: Directions of the internal forces, of any length, palm axes, shape (k, 3);
                zero: none.
            fresh: Whether the forces are new samples, shape (k,); repeated ones do not count.
            dt: Time since the last tick, s.
            freedoms: Components of a force that are tested: 2 across the internal force, or 1 for
                normal forces, which must have no internal directions.
            pressed: Forces of the fingertips that balance the joint torques, palm axes, shape
                (k, 3), N; None or NaN: unknown.
        """
        if freedoms != self._freedoms:  # a change between three axes and one is no vibration
            self._freedoms = freedoms
            self._memory["last"] = self._memory["change"] = np.nan
        pressed = np.full_like(forces, np.nan) if pressed is None else pressed
        directions = np.ascontiguousarray(normals), np.ascontiguousarray(internal)
        _watch(self._memory, self._config, forces, *directions, fresh, dt, freedoms, pressed)
        return self.state


@compiled
def _watch(
    memory: Rows,
    config: Rows,
    forces: Array,
    normals: Array,
    internal: Array,
    fresh: NDArray[np.bool_],
    dt: float,
    freedoms: int,
    pressed: Array,
) -> None:
    """Update the memory of each contact with its force; see `SlipDetector.step`."""
    shaken = 0.0
    for i in range(len(memory)):
        m, force = memory[i], forces[i]
        m["since"] += dt
        if not math.isfinite(force[0] + force[1] + force[2]):
            m["state"] = ContactState.UNKNOWN
            m["evidence"] = m["touched_for"] = m["slipped_for"] = m["spacing"] = 0.0
            m["last"][:] = m["change"][:] = m["pressed"][:] = m["pressing"][:] = np.nan
            m["rate"][:] = m["excess"] = 0.0
            m["agrees"] = False
            continue
        m["touched_for"] += min(dt, LONGEST)
        if fresh[i]:
            _shake(m, pressed[i], internal[i])
        elif m["since"] > _SILENCE * m["period"]:
            m["evidence"] = m["excess"] = 0.0
            m["agrees"] = False
        shaken = max(shaken, m["excess"])
    for i in range(len(memory)):
        m, force = memory[i], forces[i]
        if not math.isfinite(force[0] + force[1] + force[2]):
            continue
        normal = dot(force, normals[i])
        if fresh[i]:
            _take(m, config[0], force, normal, internal[i], freedoms, shaken)
        _decide(m, normal, min(dt, LONGEST))


@compiled
def _shake(m: Row, pressed: Array, internal: Array) -> None:
    """Compare the innovation of the force by the torques with the usual one."""
    since, q = _spaced(m)
    now = pressed - m["pressed"]
    r = _across(now - q * m["pressing"], internal)
    m["pressed"][:], m["pressing"][:] = pressed, now
    power = dot(r, r)
    m["excess"] = 0.0
    if not math.isfinite(power) or q > _GAP:
        return
    m["excess"] = max(0.0, power - _BOUND * m["shaking"])
    if m["touched_for"] > _SETTLING:
        power = min(power, _BOUND * m["shaking"])
    m["shaking"] += _weight(m, since) * (power - m["shaking"])


@compiled
def _take(
    m: Row, c: Row, force: Array, normal: float, internal: Array, freedoms: int, shaken: float
) -> None:
    """Test a new sample, less the power N^2 by torques, and learn the noise from it."""
    r, gain = _innovation(m, force)
    m["agrees"] = False
    if gain == 0.0:
        return
    minimum = c["minimum_noise"] ** 2 + (c["relative_noise"] * normal) ** 2
    noise = gain * max(m["variance"], minimum)
    bend, course = _across(r, internal), _across(m["rate"], internal)
    speed = math.sqrt(dot(course, course))
    along = dot(bend, course) / speed if speed > 0.0 else 0.0
    known = noise / (noise + (_LATE * speed * m["spacing"]) ** 2)
    power = max(0.0, dot(bend, bend) - along * along) + known * along * along
    samples = c["false_alarm_time"] / max(m["period"], 1e-6)
    m["threshold"] = max(1.0, _OVERLAP * math.log(samples))
    if m["touched_for"] > _SETTLING:
        beyond = max(0.0, power - shaken) / noise
        found = 0.5 * (1.0 - 1.0 / _RATIO) * beyond - 0.5 * freedoms * math.log(_RATIO)
        m["agrees"] = found > 0.0
        limit = _SAMPLE_LIMIT * m["threshold"]
        m["evidence"] = min(max(0.0, m["evidence"] + min(found, limit)), m["threshold"] + limit)
    if m["state"] != ContactState.SLIP or m["slipped_for"] > _PATIENCE:
        unbiased = _UNBIASED_ONE if freedoms == 1 else _UNBIASED
        _learn(m, power / (gain * (freedoms - 1.0 + known)), unbiased)


@compiled
def _innovation(m: Row, force: Array) -> tuple[Array, float]:
    """Return r, and its variance per variance of a sample; 0 without a prediction.

    A prediction needs three samples without a gap.
    """
    since, q = _spaced(m)
    now = force - m["last"]
    r = now - q * m["change"]
    m["last"][:] = force
    m["change"][:] = now
    m["since"] = 0.0
    if not math.isfinite(now[0]):
        return r, 0.0
    m["period"] = since
    m["spacing"] = since if q <= _GAP else 0.0
    if q > _GAP:
        return r, 0.0
    if since > 0.0:
        m["rate"][:] += -math.expm1(-since / _COURSE) * (now / since - m["rate"])
    return r, (1.0 + (1.0 + q) ** 2 + q * q) if math.isfinite(r[0]) and q > 0.0 else 0.0


@compiled
def _spaced(m: Row) -> tuple[float, float]:
    """Return the time since the last sample, s, and q; if none has passed, for even samples."""
    before = m["spacing"]
    since = m["since"] if m["since"] > 0.0 else before
    return since, since / before if before > 0.0 else 0.0


@compiled
def _decide(m: Row, normal: float, dt: float) -> None:
    slips = m["evidence"] > m["threshold"] * (_RELEASE if m["state"] == ContactState.SLIP else 1.0)
    m["slipped_for"] = m["slipped_for"] + dt if slips else 0.0
    is_known = normal > _SURE * math.sqrt(m["variance"]) and math.isfinite(m["change"][0])
    if m["touched_for"] <= _SETTLING or not is_known:
        m["state"] = ContactState.UNKNOWN
    else:
        m["state"] = ContactState.SLIP if slips else ContactState.STICK


@compiled
def _learn(m: Row, square: float, unbiased: float) -> None:
    """Follow the noise, quickly after touching; the power of a sample is bounded."""
    bounded = min(square, _BOUND * m["variance"])
    m["variance"] += _weight(m, m["spacing"]) * (unbiased * bounded - m["variance"])


@compiled
def _weight(m: Row, dt: float) -> float:
    """Return the weight of a sample in what is learned, after the time dt, s."""
    time = max(min(_LEARNING, float(m["touched_for"])), 10.0 * dt, 1e-9)
    return min(dt / time, 1.0)


@compiled
def _across(vector: Array, axis: Array) -> Array:
    """Return the part of a vector that is normal to an axis of any length."""
    square = dot(axis, axis)
    return vector - (dot(vector, axis) / square if square > 0.0 else 0.0) * axis
