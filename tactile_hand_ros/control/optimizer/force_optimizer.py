# SPDX-License-Identifier: Apache-2.0
"""The grasp-force optimization (13): how to distribute 1 N of internal force over k contacts."""

from __future__ import annotations

import enum
import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.config.hand_config import load_hand_config
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, in_palm
from tactile_hand_ros.control.grasp import (
    MIN_COLLINEARITY_MARGIN,
    centered,
    collinearity_margin,
    grasp_map,
)
from tactile_hand_ros.control.loads import LoadMarginConfig
from tactile_hand_ros.control.optimizer.cone_optimizer import ConeOptimizer
from tactile_hand_ros.control.optimizer.cones import (
    Cones,
    ConeTracker,
    cone_margin,
    followed,
    grasp_frames,
    imbalance,
)
from tactile_hand_ros.control.optimizer.quadratic_program import (
    Problem,
    QuadraticProgram,
    Solution,
)
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.hand.urdf import finger_weight

Array = NDArray[np.float64]

_MAX_RESIDUAL = 1e-6  # beyond, there is no answer
_MAX_CONE_RESIDUAL = 1e-4  # beyond, the paper's own f* is the safer answer


class ForceOptimizerConfig(Config):
    """Parameters of the grasp-force optimization (13)."""

    hand: str = param("paper", "hand by name or YAML file")
    weights: list[float] = param(
        [10.0, 1.0, 10.0],
        "diagonal of W for (f_x, f_n, f_z), three values for all contacts or three per contact",
        live=True,
        min_length=3,
    )
    minimum_normal: float = param(
        0.0,
        "minimum f_n of each contact, as a fraction of the grasp force",
        live=True,
        ge=0.0,
        lt=0.34,
    )
    solver: Literal["exact", "osqp"] = param(
        "exact",
        "exact exchanges active bounds and asks OSQP where they do not settle, osqp always asks it",
        live=True,
    )
    cones: bool = param(
        False,
        "keep internal force and load inside the friction cones that the regulator has learned",
    )
    load_time: float = param(
        0.02, "time constant with which the cones follow the load", unit="s", gt=0.0, le=10.0
    )
    shape_time: float = param(
        0.05,
        "time constant with which f* follows the optimum inside the cones, 0 for immediately",
        unit="s",
        live=True,
        ge=0.0,
        le=10.0,
    )
    load_memory: float = param(
        1.0,
        "time constant with which f* forgets the loads of the recent past",
        unit="s",
        live=True,
        gt=0.0,
        le=100.0,
    )
    reserve: LoadMarginConfig = LoadMarginConfig()
    squeeze_share: float = param(
        0.75,
        "fraction of the present grasp force with which f* should do, so that it can be lowered",
        live=True,
        gt=0.0,
        le=1.0,
    )
    cone_share: float = param(
        0.82, "fraction of the learned friction that f* may use", live=True, gt=0.0, le=1.0
    )

    def weight_vector(self, fingers: int) -> Array:
        """Return the diagonal of W, shape (3 k,).

        Raises:
            ConfigurationError: If the number of weights does not fit or one is not positive.
        """
        given = np.array(self.weights, dtype=float)
        if len(given) not in (3, 3 * fingers) or (given <= 0.0).any():
            raise ConfigurationError(
                f"weights = {self.weights}: expected 3 or {3 * fingers} positive numbers, the "
                f"diagonal of W for {fingers} contacts",
                place="weights",
            )
        return np.tile(given, fingers) if len(given) == 3 else given

    def check_minimum(self, fingers: int) -> None:
        """Check that the minimum normal forces leave something to distribute.

        Raises:
            ConfigurationError: If they add up to the grasp force or more.
        """
        if self.minimum_normal * fingers >= 1.0:
            raise ConfigurationError(
                f"minimum_normal = {self.minimum_normal}: {fingers} contacts bear fractions that "
                f"add up to 1, so that it must be below {1.0 / fingers:.3g}",
                place="minimum_normal",
            )


class Status(enum.Enum):
    """How an optimization ended."""

    SOLVED = "solved"
    CONTACT_MISSING = "contact missing"
    COLLINEAR = "collinear contacts"
    UNBALANCED = "normals cannot balance"
    FAILED = "solver failed"


class OptimalForces(NamedTuple):
    """The outcome of (13), with the means to judge it.

    Attributes:
        status: SOLVED, or why there is no answer.
        reason: One sentence for people; empty when solved.
        forces: f* on the object in the contact frames C_i, shape (k, 3); NaN unless solved.
        residual: Largest violation of the optimality conditions, with G~ f* = 0 and sum f_n = 1.
        iterations: Linear systems that were solved, or iterations of OSQP.
        solve_time: Time that OSQP reports where it was asked, s.
        cone_margin: Minimum of mu f_n - |f_t| per unit of internal force, with the load and the
            usable mu; not negative certifies that nothing has to slip; NaN without cones.
        learned_margin: The same with mu as learned, without the margin of `cone_share`.
        shaped: Whether the cones changed f*.
    """

    status: Status
    reason: str
    forces: Array
    residual: float = np.nan
    iterations: int = 0
    solve_time: float = 0.0
    cone_margin: float = np.nan
    learned_margin: float = np.nan
    shaped: bool = False

    @property
    def ok(self) -> bool:
        """Whether f* exists."""
        return self.status is Status.SOLVED


class ForceOptimizer:
    """Solves (13): min f^T W f  s.t.  G~ f = 0,  sum f_n = 1,  f_n >= minimum.

    Torques in G~ are divided by the size of the grasp, which leaves the solution as it is and makes
    all rows of one magnitude. See `quadratic_program` for how the answer is found and judged.

    Source: Shaw-Cortez et al., equation (13).
    """

    def __init__(self, config: ForceOptimizerConfig, fingers: int) -> None:
        """Set up the problem for k = `fingers` contacts.

        Raises:
            ConfigurationError: If the weights do not fit.
        """
        self._k = fingers
        self._shape: Array | None = None
        self._tracker = ConeTracker(config, fingers, finger_weight(load_hand_config(config.hand)))
        self.configure(config)

    def configure(self, config: ForceOptimizerConfig) -> None:
        """Take other weights or limits; the problem is set up again.

        Raises:
            ConfigurationError: If they do not fit; nothing is changed then.
        """
        weights = config.weight_vector(self._k)
        config.check_minimum(self._k)
        self.config, self._weights = config, weights
        self._tracker.configure(config)
        self._set_up()

    def reset(self) -> None:
        """Forget the last answer and the load."""
        self._set_up()
        self._tracker.reset()

    def reject_touch(self, rejected: bool) -> None:
        """Take whether the controller rejects the touch, from the next tick on."""
        self._tracker.reject_touch(rejected)

    def step(
        self,
        stamp: int,
        contacts: Contacts,
        friction: Array | None = None,
        forces: Array | None = None,
    ) -> OptimalForces:
        """Return f* of a tick, inside the friction cones if the configuration says so.

        Args:
            stamp: The tick, ns.
            contacts: Contact points and frames in the palm frame.
            friction: mu of each contact as the regulator has learned it, shape (k,).
            forces: Measured forces in contact frames, shape (k, 3), N; without friction or forces
                the cones are left out.
        """
        if not self.config.cones or friction is None or forces is None:
            return self.solve(contacts)
        # Planes and memory of the cones in frames that turn with the grasp: what follows from them
        # must not depend on how the grasp lies in the palm.
        frames = contacts.rotations
        if contacts.all_touching:
            frames = grasp_frames(contacts.positions, frames)
        turns = np.swapaxes(frames, 1, 2) @ contacts.rotations
        grasp = Contacts(contacts.positions, frames)
        usable = self.config.cone_share * friction
        cones = self._tracker.step(stamp, grasp, in_palm(turns, forces, 1.0), usable)
        optimal = self.solve(grasp, cones)
        if not optimal.ok:
            return optimal
        learned = np.nan if cones is None else cone_margin(optimal.forces, cones.load, friction)
        back = in_palm(np.swapaxes(turns, 1, 2), optimal.forces, 1.0)
        return optimal._replace(forces=back, learned_margin=learned)

    def solve(self, contacts: Contacts, cones: Cones | None = None) -> OptimalForces:
        """Distribute a unit internal force over the contacts.

        Args:
            contacts: Contact points and frames in the palm frame.
            cones: Usable friction and load of the contacts; (13) does not look at them by default.

        Returns:
            f* in contact frames, or a status that says why there is none.
        """
        if not contacts.all_touching:
            missing = ", ".join(str(i + 1) for i in np.flatnonzero(~contacts.touching))
            return self._without_answer(
                Status.CONTACT_MISSING, f"no contact at finger {missing}; all must touch (A7)"
            )
        points, rotations = contacts.positions, contacts.rotations
        problem, balance, margin = _balance_problem(self._fixed, points, rotations)
        if margin < MIN_COLLINEARITY_MARGIN:
            return self._without_answer(
                Status.COLLINEAR,
                "the contacts lie on one line, no moment about it can balance (A7)",
            )
        found = self._program.solve(problem)
        if not found.residual < _MAX_RESIDUAL:
            self._shape = None
            return self._unsolved(found)
        forces, residual, shaped, inside = (
            found.x.reshape(self._k, 3),
            found.residual,
            False,
            np.nan,
        )
        if cones is None:
            self._shape = None
        else:
            forces, residual, shaped = self._inside(forces, residual, balance, cones)
            forces = self._steadied(forces, balance, cones)
            residual = max(residual, *imbalance(forces, balance))
            inside = cones.margin(forces)
        how = found.iterations, found.solve_time
        return OptimalForces(Status.SOLVED, "", forces, residual, *how, inside, np.nan, shaped)

    def _inside(
        self, forces: Array, residual: float, balance: Array, cones: Cones
    ) -> tuple[Array, float, bool]:
        """Keep an answer inside its cones, where it is optimal too, and reshape any other.

        Returns:
            The optimum, its residual, and whether the cones changed it.
        """
        if cones.holds(forces):
            return forces, residual, False
        shaped, missing = self._shaper.solve(balance, cones)
        if not missing < _MAX_CONE_RESIDUAL:
            return forces, residual, False
        return shaped, missing, True

    def _steadied(self, optimum: Array, balance: Array, cones: Cones) -> Array:
        """Follow an optimum steadily, see `followed`; the first one is followed immediately."""
        before, time, forces = self._shape, self.config.shape_time, optimum
        if before is not None and time > 0.0 and cones.elapsed > 0.0:
            fraction = 1.0 - math.exp(-cones.elapsed / time)
            learned = cones.usable_friction / self.config.cone_share
            steady, found = followed(before, optimum, balance, cones.load, learned, fraction)
            forces = steady if found else optimum
        self._shape = forces
        return forces

    def _set_up(self) -> None:
        k, minimum = self._k, self.config.minimum_normal
        equal, right, rows = np.zeros((7, 3 * k)), np.zeros(7), np.zeros((k, 3 * k))
        equal[6, 1::3] = right[6] = 1.0
        rows[np.arange(k), 1 + 3 * np.arange(k)] = -1.0
        bounds = np.full(k, -minimum)
        self._fixed = Problem(self._weights, np.zeros(3 * k), equal, right, rows, bounds)
        example = self._fixed._replace(equal=np.vstack([np.ones((6, 3 * k)), equal[6:]]))
        is_exact = self.config.solver == "exact"
        self._program = QuadraticProgram(example, is_exact)
        self._shaper = ConeOptimizer(self._weights, minimum, is_exact)
        self._shape = None

    def _unsolved(self, best: Solution) -> OptimalForces:
        if best.is_infeasible:
            return self._without_answer(
                Status.UNBALANCED,
                "no pushing forces at these contacts balance; place a finger on an opposing face",
            )
        return self._without_answer(
            Status.FAILED,
            f"OSQP ended with '{best.ending}' after {best.iterations} iterations, and the best "
            f"residual is {best.residual:.1e}; the last answer is not used",
        )

    def _without_answer(self, status: Status, reason: str) -> OptimalForces:
        return OptimalForces(status, reason, np.full((self._k, 3), np.nan))


@compiled
def scaled_balance(points: Array, rotations: Array) -> Array:
    """Return G~^T for forces in contact frames, torques per size of the grasp, shape (3k, 6).

    The torques of the grasp map (11) are divided by the size of the grasp, which leaves G~ f = 0 as
    it is and makes all rows of one magnitude.

    Args:
        points: Contact points in the palm frame, shape (k, 3), m.
        rotations: Contact frames, shape (k, 3, 3).
    """
    arms = centered(points)
    arms /= math.sqrt((arms * arms).sum() / len(points))
    return grasp_map(arms, rotations).T


@compiled
def _balance_problem(
    fixed: Problem, points: Array, rotations: Array
) -> tuple[Problem, Array, float]:
    """Return (13) with the balance of these contacts, G~^T and the collinearity margin."""
    balance, equal = scaled_balance(points, rotations), fixed.equal.copy()
    equal[:6] = balance.T
    problem = Problem(fixed.weights, fixed.price, equal, fixed.right, fixed.rows, fixed.bounds)
    return problem, balance, collinearity_margin(points)
