# SPDX-License-Identifier: Apache-2.0
"""The grasp-force optimization (13): how to share a squeeze of 1 N among the contacts."""

from __future__ import annotations

import enum
import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import (
    MIN_COLLINEARITY_MARGIN,
    centred,
    collinearity_margin,
    grasp_map,
)
from tactile_hand_ros.control.loads import LoadMarginConfig
from tactile_hand_ros.control.optimizer.active_set import solve_exactly
from tactile_hand_ros.control.optimizer.cone_optimizer import ConeOptimizer
from tactile_hand_ros.control.optimizer.cones import (
    Cones,
    ConeTracker,
    cone_margin,
    followed,
    imbalance,
)
from tactile_hand_ros.control.optimizer.warm_solver import INFEASIBLE, SOLVED, WarmSolver
from tactile_hand_ros.errors import ConfigurationError

Array = NDArray[np.float64]

_MAX_RESIDUAL = 1e-6  # OSQP's own tolerance; polishing goes far below it
_GOOD_RESIDUAL = 1e-10  # above it polishing has missed the active bounds
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
        0.0, "least share f_n of each contact in the unit squeeze", live=True, ge=0.0, lt=0.34
    )
    solver: Literal["exact", "osqp"] = param(
        "exact",
        "exact exchanges active bounds and asks OSQP where they do not settle, osqp always asks it",
        live=True,
    )
    cones: bool = param(
        False, "keep squeeze and load inside the friction cones that the regulator has learned"
    )
    load_time: float = param(
        0.02, "time constant with which the cones follow the load", unit="s", gt=0.0, le=10.0
    )
    shape_time: float = param(
        0.05,
        "time constant with which f* follows the optimum inside the cones, 0 for at once",
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
        "share of the present squeeze with which f* should do, so that it can be lowered",
        live=True,
        gt=0.0,
        le=1.0,
    )
    cone_share: float = param(
        0.82, "share of the learned friction that f* may use", live=True, gt=0.0, le=1.0
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
        """Check that the least shares leave something to share.

        Raises:
            ConfigurationError: If they add up to the whole squeeze or more.
        """
        if self.minimum_normal * fingers >= 1.0:
            raise ConfigurationError(
                f"minimum_normal = {self.minimum_normal}: {fingers} contacts share a squeeze of "
                f"1, so that it must be below {1.0 / fingers:.3g}",
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
        balance_residual: Largest component of G~ f*, relative to the largest force above 1 N, as
            the next two.
        sum_residual: |sum f_n - 1|.
        stationarity_residual: Largest component of the Lagrangian's gradient, scaled by max W.
        bound_residual: Largest force that a lower bound is missed by, or that a bound pulls from
            afar, weighted by its share of the largest multiplier.
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
    balance_residual: float = np.nan
    sum_residual: float = np.nan
    stationarity_residual: float = np.nan
    bound_residual: float = np.nan
    iterations: int = 0
    solve_time: float = 0.0
    cone_margin: float = np.nan
    learned_margin: float = np.nan
    shaped: bool = False

    @property
    def ok(self) -> bool:
        """Whether f* exists."""
        return self.status is Status.SOLVED

    @property
    def residual(self) -> float:
        """The largest of the four residuals; NaN if one is."""
        values = self[3:7]
        return math.nan if any(map(math.isnan, values)) else max(values)


class ForceOptimizer:
    """Solves (13): min f^T W f  s.t.  G~ f = 0,  sum f_n = 1,  f_n >= minimum.

    The answer is found by exchanging active bounds, exactly and mostly in one linear system, and is
    taken when it meets the optimality conditions. Where that fails, there is no answer, or the
    configuration says so, OSQP decides: it is set up once, gets the numbers of G~ and starts from
    its last answer. Torques in G~ are divided by the size of the grasp, which leaves the solution
    as it is and makes all rows of one magnitude.

    Source: Shaw-Cortez et al., equation (13); Stellato et al., OSQP, 2020.
    """

    def __init__(self, config: ForceOptimizerConfig, fingers: int) -> None:
        """Set up the problem for k = `fingers` contacts.

        Raises:
            ConfigurationError: If the weights do not fit.
        """
        self._k = fingers
        self._columns = 3 * fingers
        self._shaper: ConeOptimizer | None = None
        self._shape: Array | None = None
        self._tracker = ConeTracker(config, fingers)
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
        usable = self.config.cone_share * friction
        cones = self._tracker.step(stamp, contacts, forces, usable)
        optimal = self.solve(contacts, cones)
        if cones is None or not optimal.ok:
            return optimal
        learned = cone_margin(optimal.forces, cones.load, friction)
        return OptimalForces(*optimal[:-2], learned, optimal.shaped)

    def solve(self, contacts: Contacts, cones: Cones | None = None) -> OptimalForces:
        """Share a unit squeeze among the contacts.

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
        balance, margin, forces, residuals, systems = _exact_answer(
            contacts.positions,
            contacts.rotations,
            self._weights,
            self.config.minimum_normal,
            self._held,
        )
        if margin < MIN_COLLINEARITY_MARGIN:
            return self._without_answer(
                Status.COLLINEAR,
                "the contacts lie on one line, no moment about it can balance (A7)",
            )
        solved = OptimalForces(Status.SOLVED, "", forces, *residuals, systems)
        is_exact = systems > 0 and solved.residual < _GOOD_RESIDUAL
        if not is_exact or self.config.solver == "osqp":
            solved = self._by_osqp(balance, solved)
        if cones is None or not solved.ok:
            self._shape = None
            return solved
        forces, residual, shaped = self._inside(solved, balance, cones)
        forces = self._steadied(forces, balance, cones)
        unbalanced, excess = imbalance(forces, balance)
        # Not by _replace, whose tuple the collector would count as made and not as freed.
        return OptimalForces(
            Status.SOLVED,
            "",
            forces,
            unbalanced,
            excess,
            residual,
            solved.bound_residual,
            solved.iterations,
            solved.solve_time,
            cones.margin(forces),
            np.nan,
            shaped,
        )

    def _inside(
        self, solved: OptimalForces, balance: Array, cones: Cones
    ) -> tuple[Array, float, bool]:
        """Keep an answer inside its cones, where it is optimal too, and reshape any other.

        Returns:
            The optimum, its stationarity residual, and whether the cones changed it.
        """
        if cones.holds(solved.forces):
            return solved.forces, solved.stationarity_residual, False
        if self._shaper is None:
            c = self.config
            self._shaper = ConeOptimizer(self._weights, c.minimum_normal, c.solver == "exact")
        forces, residual = self._shaper.solve(balance, cones)
        if not residual < _MAX_CONE_RESIDUAL:
            self._shaper = None
            return solved.forces, solved.stationarity_residual, False
        return forces, residual, True

    def _steadied(self, optimum: Array, balance: Array, cones: Cones) -> Array:
        """Follow an optimum steadily, see `steady`; the first one is followed at once."""
        before, time, forces = self._shape, self.config.shape_time, optimum
        if before is not None and time > 0.0 and cones.elapsed > 0.0:
            share = 1.0 - math.exp(-cones.elapsed / time)
            learned = cones.usable_friction / self.config.cone_share
            steady, found = followed(before, optimum, balance, cones.load, learned, share)
            forces = steady if found else optimum
        self._shape = forces
        return forces

    def _set_up(self) -> None:
        k, n = self._k, self._columns
        normals = np.arange(1, n, 3)
        # Constraint rows: 6 of balance (dense, filled in by solve), the sum, the lower bounds.
        rows = np.zeros((7 + k, n))
        rows[:6] = 1.0
        rows[6, normals] = 1.0
        rows[7 + np.arange(k), normals] = 1.0
        matrix = sparse.csc_matrix(rows)
        self._values = matrix.data.copy()
        self._balance_slots = np.flatnonzero(matrix.indices < 6)
        self._shaper = None
        self._shape = None
        self._held = np.zeros(k, dtype=np.bool_)
        lower = np.concatenate([np.zeros(6), [1.0], np.full(k, self.config.minimum_normal)])
        upper = np.concatenate([np.zeros(6), [1.0], np.full(k, np.inf)])
        self._solver = WarmSolver(
            2.0 * self._weights,
            np.zeros(n),
            matrix,
            lower,
            upper,
            eps_abs=_MAX_RESIDUAL,
            eps_rel=_MAX_RESIDUAL,
            polishing=True,
            warm_starting=True,
            max_iter=4000,
            check_termination=5,
            adaptive_rho_interval=25,  # by iterations, never by time: equal inputs, equal answers
        )

    def _by_osqp(self, balance: Array, exact: OptimalForces) -> OptimalForces:
        """Solve for G~^T of shape (3k, 6) from OSQP's last answer.

        The residuals decide, not how OSQP ends: at its limit of iterations, or where forces are so
        large that it takes the problem for infeasible, the better answer may still be the optimum.
        """
        self._values[self._balance_slots] = balance.ravel()
        x, y, info = self._solver.solve(self._values)
        solved = self._measured(x, y, balance, info)
        if not solved.residual < _GOOD_RESIDUAL:
            candidates = [solved, exact]
            if sharp := self._sharpened(x, y, balance):
                candidates.append(self._measured(*sharp, balance, info))
            solved = min(candidates, key=lambda forces: np.nan_to_num(forces.residual, nan=np.inf))
        if info.status_val != SOLVED:
            self._set_up()  # where OSQP has ended is a bad start for the next grasp
        return solved if solved.residual < _MAX_RESIDUAL else self._unsolved(solved, info)

    def _unsolved(self, best: OptimalForces, info: Any) -> OptimalForces:
        if info.status_val in INFEASIBLE:
            return self._without_answer(
                Status.UNBALANCED,
                "no pushing forces at these contacts balance; place a finger on an opposing face",
            )
        self._set_up()
        return self._without_answer(
            Status.FAILED,
            f"OSQP ended with '{info.status}' after {info.iter} iterations, and the best residual "
            f"is {best.residual:.1e}; the last answer is not used",
        )

    def _measured(self, x: Array, y: Array, balance: Array, info: Any) -> OptimalForces:
        residuals = optimality(x, y, balance, self._weights, self.config.minimum_normal)
        forces = np.array(x).reshape(self._k, 3)
        return OptimalForces(
            Status.SOLVED, "", forces, *residuals, int(info.iter), float(info.run_time)
        )

    def _sharpened(self, x: Array, y: Array, balance: Array) -> tuple[Array, Array] | None:
        """Solve exactly from the bounds that OSQP's answer touches, where its polishing missed."""
        least = self.config.minimum_normal
        held = x[1::3] - least < -y[7:]
        x, y, systems = solve_exactly(balance, self._weights, least, held)
        return (x, y) if systems else None

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
    arms = centred(points)
    arms /= math.sqrt((arms * arms).sum() / len(points))
    return grasp_map(arms, rotations).T


@compiled
def _exact_answer(
    points: Array, rotations: Array, weights: Array, least: float, held: NDArray[np.bool_]
) -> tuple[Array, float, Array, tuple[float, float, float, float], int]:
    """Return G~^T, the collinearity margin, f*, its residuals and the number of systems.

    Without systems, or on a line, f* is of no use. For `held` see `solve_exactly`.
    """
    balance, margin = scaled_balance(points, rotations), collinearity_margin(points)
    x, y, systems = solve_exactly(balance, weights, least, held)
    residuals = optimality(x, y, balance, weights, least)
    return balance, margin, x.reshape(-1, 3), residuals, systems


@compiled
def optimality(
    x: Array, y: Array, balance: Array, weights: Array, least: float
) -> tuple[float, float, float, float]:
    """Return the residuals of (13): balance, sum, stationarity and bounds.

    (13) is strictly convex: what has none is the optimum. They are relative to the largest force
    where that is above 1 N, since rounding is.

    Args:
        x: Forces in contact frames, shape (3k,).
        y: Multipliers of balance, sum and lower bounds, shape (7 + k,).
        balance: G~^T, shape (3k, 6).
        weights: Diagonal of W, shape (3k,).
        least: Lower bound of the normal forces.
    """
    unbalanced, total, slope, bound = np.zeros(6), -1.0, 0.0, 0.0
    pull = max(np.abs(y).max(), weights.max())
    for i in range(len(x)):
        gradient = 2.0 * weights[i] * x[i]
        for j in range(6):
            unbalanced[j] += balance[i, j] * x[i]
            gradient += balance[i, j] * y[j]
        if i % 3 == 1:
            push = min(y[7 + i // 3], 0.0)  # a bound can only push upwards
            total += x[i]
            gradient += y[6] + push
            above = x[i] - least
            bound = max(bound, -above, abs(push * above) / pull)
        slope = max(slope, abs(gradient))
    size = max(np.abs(x).max(), 1.0)
    return (
        np.abs(unbalanced).max() / size,
        abs(total) / size,
        slope / weights.max() / size,
        bound / size,
    )
