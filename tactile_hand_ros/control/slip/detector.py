# SPDX-License-Identifier: Apache-2.0
"""Whether a contact slips, from the micro-vibration that sliding leaves in their forces."""

from __future__ import annotations

import enum
import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Row, Rows, compiled, row_of
from tactile_hand_ros.config.model import Config, param

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

_GAIN = 6.0  # of white noise through a second difference: 1 + 4 + 1
_BOUND = 3.0  # times its noise, for which a sample counts at most while the noise is learned
_UNBIASED = 1.0 / (1.0 - math.exp(-_BOUND))  # makes up for it: power has two degrees of freedom
_BRINK = 0.95  # fraction of the learned friction from which on a contact may well be slipping
_LEAK = 0.03  # fraction of a change of the internal force that may show across it
_COURSE = 0.01  # s, time constant of the rate at which a force changes
_STEADY = 0.01  # N, change from sample to sample below which a force counts as steady
_FASTEST = 600.0  # N/s that a hand changes a force at; what is faster is a push, and counts as much
_SHIFT = 3.0  # samples by which commands that are late now and then shift the course of a force
_GAP = 2.5  # times the usual time between samples; after so long their differences start again
_LONGEST = 0.02  # s that a pause counts for at most: nothing is known of it


class SlipDetectorConfig(Config):
    """Parameters of the slip detector."""

    noise: float = param(
        0.02, "expected noise of a force until it is learned", unit="N", live=True, gt=0.0
    )
    least_noise: float = param(
        0.002, "vibration below this is never taken for slip", unit="N", live=True, gt=0.0
    )
    relative_noise: float = param(0.002, "the same, per normal force", live=True, ge=0.0)
    patience: float = param(
        0.3,
        "what looks like slip for longer than this is learned as noise",
        unit="s",
        live=True,
        gt=0.0,
    )
    ratio: float = param(
        9.0, "power of the vibration against noise that the test is made for", live=True, gt=1.0
    )
    threshold: float = param(
        28.0, "evidence for slip; false alarms become rarer as its exponential", live=True, gt=0.0
    )
    learning_time: float = param(
        1.0, "time constant with which the noise is learned", unit="s", live=True, gt=0.0
    )
    settling_time: float = param(
        0.05,
        "after touching, nothing is reported about slip for so long",
        unit="s",
        live=True,
        ge=0.0,
    )
    least_force: float = param(
        0.05, "normal force below which nothing is reported", unit="N", live=True, gt=0.0
    )


class ContactState(enum.IntEnum):
    """What is known of a contact; unknown is not the same as no slip."""

    UNKNOWN = 0
    STICK = 1
    SLIP = 2


_MEMORY = np.dtype(
    [
        ("state", np.int64),  # ContactState
        ("evidence", np.float64),
        ("likelihood", np.float64),
        ("agrees", np.bool_),
        ("variance", np.float64),  # of the second difference across the internal force, per axis
        ("last", np.float64, 3),  # force; NaN where there was none, as is what follows from it
        ("change", np.float64, 3),  # of it from sample to sample
        ("rate", np.float64, 3),  # of it, smoothed, N/s
        ("since", np.float64),  # the last sample, s
        ("spacing", np.float64),  # of the last two samples, s; 0: unknown
        ("fresh", np.bool_),
        ("touched_for", np.float64),
        ("slipped_for", np.float64),
    ],
    align=True,
)


class SlipDetector:
    """Watches the power of fast force changes at each contact with Page's cumulative sum test.

    While a contact sticks, the second difference r of its force is noise of variance s^2, since
    loads change slowly against the sampling. Sliding adds vibration. The hand's own changes of the
    internal force act along one known direction; only the two others are looked at. The test sums
    the log-likelihood ratio of variance rho s^2 against s^2, per axis

        L = ((1 - 1/rho) r^2 / s^2 - ln rho) / 2,

    starts again from zero whenever the sum is negative, and reports slip above a threshold h.
    While a contact sticks the time between false alarms grows as exp(h). A single sample never
    counts for more than h / 4: a push on the object shows in one sample, sliding in many.

    Samples need not come evenly: with q the time since the last one per time between the two before
    it, r = f_t - f_(t-1) - q (f_(t-1) - f_(t-2)), and white noise of variance v makes it
    (1 + (1 + q)^2 + q^2) v, which is scaled to the 6 v of even samples. After a gap the differences
    start again, and evidence and noise stay as they were.

    Commands that are late by a number of ticks that varies shift what the hand does along its own
    course, f(t - d): a force that changes at a rate f' then bends by some f' dt along f'. Along the
    part of f' across the internal force the variance therefore grows by (3 f' dt)^2.

    Source: Page, Continuous inspection schemes, 1954.
    """

    def __init__(self, config: SlipDetectorConfig, contacts: int) -> None:
        """Watch a number k of contacts, each by itself."""
        self._memory: Rows = np.zeros(contacts, _MEMORY)
        self.configure(config)
        self.reset()

    def configure(self, config: SlipDetectorConfig) -> None:
        """Take other parameters; what is known of the contacts stays."""
        self._noise = config.noise
        self._config = row_of(config)

    def reset(self) -> None:
        """Forget everything."""
        self._memory[:] = np.zeros((), _MEMORY)
        self._memory["variance"] = _GAIN * self._noise**2
        self._memory["last"] = self._memory["change"] = np.nan

    @property
    def state(self) -> NDArray[np.int64]:
        """What is known of each contact, `ContactState`, shape (k,)."""
        return self._memory["state"].copy()

    @property
    def evidence(self) -> Array:
        """The sum of each contact, above `threshold` a slip, shape (k,)."""
        return self._memory["evidence"].copy()

    @property
    def likelihood(self) -> Array:
        """Evidence for slip against its threshold, 0 to 1, shape (k,)."""
        return self._memory["likelihood"].copy()

    @property
    def agrees(self) -> NDArray[np.bool_]:
        """Whether the newest sample of each contact shows slip rather than stick, shape (k,)."""
        return self._memory["agrees"].copy()

    @property
    def fresh(self) -> NDArray[np.bool_]:
        """Whether the newest force of each contact is a new sample that could be judged."""
        return self._memory["fresh"].copy()

    def step(
        self, forces: Array, direction: Array, own_change: float, dt: float, learned_friction: Array
    ) -> NDArray[np.int64]:
        """Take the forces of a tick and return what is known of the contacts, shape (k,).

        Args:
            forces: Measured forces in contact frames (x, n, z), shape (k, 3), N; NaN where there is
                none.
            direction: Directions in which the hand's internal force acts here, of any length, shape
                (k, 3).
            own_change: How much the hand itself has just bent its internal force, N; some of that
                shows across the internal force too.
            dt: Time since the last tick, s.
            learned_friction: mu as learned so far, shape (k,). At the brink of that cone fewer
                samples must agree: a false alarm there could not lower the estimate.
        """
        _watch(self._memory, self._config, forces, direction, own_change, dt, learned_friction)
        return self.state


@compiled
def _watch(
    memory: Rows,
    config: Rows,
    forces: Array,
    direction: Array,
    own_change: float,
    dt: float,
    learned_friction: Array,
) -> None:
    """Let each contact of a memory take its force."""
    c = config[0]
    for i in range(len(memory)):
        m = memory[i]
        _detect(m, c, forces[i], direction[i], own_change, dt, learned_friction[i])
        m["likelihood"] = min(m["evidence"] / c["threshold"], 1.0)


@compiled
def _detect(
    m: Row,
    c: Row,
    force: Array,
    direction: Array,
    own_change: float,
    dt: float,
    learned_friction: float,
) -> None:
    x, n, z = force
    last = m["last"]
    m["since"] += dt
    # A sensor that is slower than the loop repeats its sample, which adds nothing.
    new = not (x == last[0] and n == last[1] and z == last[2])
    bend, gain = _bend(m, x, n, z) if new else ((0.0, 0.0, 0.0), 0.0)
    m["fresh"] = gain > 0.0
    if not math.isfinite(bend[0] + bend[1] + bend[2]) or n <= c["least_force"]:
        m["touched_for"] = m["evidence"] = 0.0
        m["rate"][0] = m["rate"][1] = m["rate"][2] = 0.0
        m["state"] = ContactState.UNKNOWN
        m["fresh"] = False
        return
    known = min(dt, _LONGEST)
    m["touched_for"] += known
    across, along, shift, variance = 0.0, 0.0, 0.0, _noise(m, c, n, own_change)
    if m["fresh"]:
        axis, scale = (direction[0], direction[1], direction[2]), _GAIN / gain
        across, along, shift = _powers(m, bend, axis)
        across, along, shift = scale * across, scale * along, scale * shift
    fraction = variance / (variance + shift)
    power = across + fraction * along
    if new:
        _follow(m)
    if m["touched_for"] <= c["settling_time"]:
        if m["fresh"]:
            _learn(m, c, power / (1.0 + fraction))
        m["evidence"] = 0.0
        m["state"] = ContactState.UNKNOWN
        return
    if m["fresh"]:
        brink = math.sqrt(x * x + z * z) > _BRINK * learned_friction * n
        _collect(m, c, power / variance, 1.0 / 3.0 if brink else 0.25)
    _decide(m, c, known)
    if m["fresh"] and (m["state"] == ContactState.STICK or m["slipped_for"] > c["patience"]):
        _learn(m, c, power / (1.0 + fraction))


@compiled
def _bend(m: Row, x: float, n: float, z: float) -> tuple[Vector, float]:
    """Return the second difference of the force and what it makes of white noise.

    It is NaN until there are three samples. The second is 0 where the difference shows nothing: the
    last two samples, or the two before, are too far apart.
    """
    last, change, before = m["last"], m["change"], m["spacing"]
    since = m["since"] if m["since"] > 0.0 else before  # without a time it came evenly
    dx, dn, dz = x - last[0], n - last[1], z - last[2]
    q = since / before if before > 0.0 else 1.0
    bend = dx - q * change[0], dn - q * change[1], dz - q * change[2]
    gain = 1.0 + (1.0 + q) ** 2 + q * q if before > 0.0 else 0.0
    last[0], last[1], last[2] = x, n, z
    change[0], change[1], change[2] = dx, dn, dz
    m["spacing"] = since if q <= _GAP else 0.0
    m["since"] = 0.0
    if q > _GAP or gain == 0.0:
        return (0.0 * bend[0], 0.0 * bend[1], 0.0 * bend[2]), 0.0
    return bend, gain


@compiled
def _follow(m: Row) -> None:
    """Smooth the rate at which the force changes."""
    change, rate, step = m["change"], m["rate"], m["spacing"]
    if step > 0.0:
        x, n, z = change
        maximum = _FASTEST * step / max(math.sqrt(x * x + n * n + z * z), 1e-12)
        kept, fraction = min(1.0, maximum) / step, -math.expm1(-step / _COURSE)
        for axis in range(3):
            rate[axis] += fraction * (kept * change[axis] - rate[axis])


@compiled
def _noise(m: Row, c: Row, normal: float, own_change: float) -> float:
    """Return the variance of a second difference of a contact that sticks, per axis."""
    minimum = _GAIN * (c["least_noise"] ** 2 + (c["relative_noise"] * normal) ** 2)
    return float(max(m["variance"], minimum) + (_LEAK * own_change) ** 2)


@compiled
def _collect(m: Row, c: Row, power: float, maximum: float) -> None:
    """Add the evidence of a power against its noise, at most a fraction of the threshold."""
    gain = 0.5 * ((1.0 - 1.0 / c["ratio"]) * power - 2.0 * math.log(c["ratio"]))
    m["agrees"] = gain > 0.0
    total = max(0.0, m["evidence"] + min(gain, maximum * c["threshold"]))
    m["evidence"] = min(total, 1.2 * c["threshold"])


@compiled
def _decide(m: Row, c: Row, dt: float) -> None:
    fraction = 0.75 if m["state"] == ContactState.SLIP else 1.0
    slips = m["evidence"] > fraction * c["threshold"]
    m["slipped_for"] = m["slipped_for"] + dt if slips else 0.0
    m["state"] = ContactState.SLIP if slips else ContactState.STICK


@compiled
def _learn(m: Row, c: Row, square: float) -> None:
    """Follow the noise, quickly after touching; a push counts for no more than its noise."""
    dt = m["spacing"]
    time = max(min(c["learning_time"], m["touched_for"]), 10.0 * dt, 1e-9)
    bounded = min(square, _BOUND * m["variance"])
    m["variance"] += min(dt / time, 1.0) * (_UNBIASED * bounded - m["variance"])


@compiled
def _powers(m: Row, bend: Vector, axis: Vector) -> tuple[float, float, float]:
    """Return the squares of a bend across an axis, across the course of the force and along it.

    The third is what commands that are late now and then add to the second.
    """
    x, y, z = _across(bend, axis)
    rate = m["rate"]
    u, v, w = _across((rate[0], rate[1], rate[2]), axis)
    square, speed = x * x + y * y + z * z, math.sqrt(u * u + v * v + w * w)
    change = speed * m["spacing"] - _STEADY
    if change <= 0.0:
        return 0.5 * square, 0.5 * square, 0.0
    shift = _SHIFT * change
    along = (x * u + y * v + z * w) / speed
    return max(0.0, square - along * along), along * along, shift * shift


@compiled
def _across(vector: Vector, axis: Vector) -> Vector:
    """Return the part of a vector that is normal to an axis of any length."""
    x, y, z = vector
    a, b, c = axis
    length = a * a + b * b + c * c
    fraction = (x * a + y * b + z * c) / length if length > 0.0 else 0.0
    return x - fraction * a, y - fraction * b, z - fraction * c
