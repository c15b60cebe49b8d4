# SPDX-License-Identifier: Apache-2.0
"""The grasp-force optimization (13): the distribution of 1 N of internal force over k contacts."""

from __future__ import annotations

import enum
import math
from typing import Literal, NamedTuple

import numpy as np

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import (
    MIN_CONTACTS,
    Contacts,
    all_finite,
    in_contacts,
    in_palm,
)
from tactile_hand_ros.control.grasp import (
    MIN_COLLINEARITY_MARGIN,
    centered,
    collinearity_margin,
    grasp_map,
)
from tactile_hand_ros.control.loads import CarriedLoad
from tactile_hand_ros.control.optimizer.cone_optimizer import ConeOptimizer
from tactile_hand_ros.control.optimizer.cones import (
    Cones,
    followed,
    grasp_frames,
    imbalance,
    reaches,
    with_reserve,
)
from tactile_hand_ros.control.optimizer.quadratic_program import Problem, QuadraticProgram
from tactile_hand_ros.errors import ConfigurationError

_RELAXED = 0.75  # fraction of the grasp force at which f* must hold, so that k_f can fall
_MAX_RESIDUAL = 1e-6  # a larger one means no solution
_UNBALANCED = "no pushing forces at these contacts balance; place a finger on an opposing face"
_MAX_CONE_RESIDUAL = 1e-4  # with a larger one, f* without cones is safer


class ForceOptimizerConfig(Config):
    """Parameters of the grasp-force optimization (13)."""

    hand: str = param("paper", "hand by name or YAML file")
    weights: list[float] = param(
        [10.0, 1.0, 10.0],
        "diagonal of W for (f_x, f_n, f_z), three values for all contacts or three per contact; "
        "with cones, x and z turn with the grasp",
        live=True,
        min_length=3,
    )
    minimum_normal: float = param(
        0.0, "minimum f_n of each contact, as a fraction of k_f", live=True, ge=0.0, lt=0.34
    )
    solver: Literal["exact", "osqp"] = param(
        "exact",
        "exact exchanges active bounds and falls back to OSQP, osqp always uses OSQP",
        live=True,
    )
    cones: bool = param(
        False,
        "keep internal force and load inside the friction cones that the regulator has learned",
    )
    shape_time: float = param(
        0.05, "time constant of f* in the cones, 0 for none", unit="s", live=True, ge=0.0, le=10.0
    )
    load_memory: float = param(
        1.0, "time constant of the memory of loads", unit="s", live=True, gt=0.0, le=100.0
    )

    def weight_vector(self, fingers: int) -> Array:
        """Return the diagonal of W of k contacts, shape (3 k,).

        Raises:
            ConfigurationError: If the number of weights does not fit, one is not positive, or the
                minimum normal forces add up to the grasp force or more.
        """
        given = np.array(self.weights, dtype=float)
        if len(given) not in (3, 3 * fingers) or (given <= 0.0).any():
            raise ConfigurationError(
                f"weights = {self.weights}: expected 3 or {3 * fingers} positive numbers, the "
                f"diagonal of W for {fingers} contacts"
            )
        if self.minimum_normal * fingers >= 1.0:
            raise ConfigurationError(
                f"minimum_normal = {self.minimum_normal}: {fingers} contacts bear fractions that "
                f"add up to 1, so that it must be below {1.0 / fingers:.3g}"
            )
        return np.tile(given, fingers) if len(given) == 3 else given


class Status(enum.Enum):
    """How an optimization ended."""

    SOLVED = "solved"
    CONTACT_MISSING = "contact missing"
    COLLINEAR = "collinear contacts"
    UNBALANCED = "normals cannot balance"
    FAILED = "solver failed"


class OptimalForces(NamedTuple):
    """The outcome of (13), with its residual.

    Attributes:
        status: SOLVED, or why there is no solution.
        reason: The same as a sentence; empty if solved.
        forces: f* on the object in the contact frames C_i, shape (k, 3); zero without a contact,
            NaN unless solved.
        residual: Largest violation of the optimality conditions, with G~ f* = 0 and sum f_n = 1.
        iterations: Number of linear systems, or iterations of OSQP.
        solve_time: Time in OSQP, s; 0 if it was not used.
        cone_margin: Minimum of mu f_n - |f_t| per unit of internal force, with the load and the
            usable mu; not negative if no contact has to slip; NaN without cones.
        shaped: Whether the cones changed f*.
    """

    status: Status
    reason: str
    forces: Array
    residual: float = np.nan
    iterations: int = 0
    solve_time: float = 0.0
    cone_margin: float = np.nan
    shaped: bool = False

    @property
    def ok(self) -> bool:
        """Whether f* exists."""
        return self.status is Status.SOLVED


class ForceOptimizer:
    """Solves (13): min f^T W f  s.t.  G~ f = 0,  sum f_n = 1,  f_n >= minimum.

    See `quadratic_program` for the method and `scaled_balance` for G~.

    Source: Shaw-Cortez et al., equation (13).
    """

    def __init__(self, config: ForceOptimizerConfig, fingers: int) -> None:
        """Set up the problem of k contacts.

        Raises:
            ConfigurationError: If the weights do not fit.
        """
        self._k = fingers
        self._shape: Array | None = None
        self._past: tuple[int, Array] | None = None  # tick, ns, and the worst recent loads
        self.configure(config)

    def configure(self, config: ForceOptimizerConfig) -> None:
        """Change the weights or limits, and set up the problem again.

        Raises:
            ConfigurationError: If they do not fit; then the old ones stay.
        """
        self._weights, self.config = config.weight_vector(self._k), config
        self._set_up()

    def reset(self) -> None:
        """Forget the last solution and the recent loads."""
        self._set_up()
        self._past = None

    def step(
        self,
        stamp: int,
        contacts: Contacts,
        carried: CarriedLoad | None = None,
        grasp_force: float = np.nan,
    ) -> OptimalForces:
        """Return f* of a tick, ns, inside the friction cones if they are configured.

        They do not apply without `carried`, the load, usable friction and reserve from the
        regulator. The grasp force is k_f of the tick, N.
        """
        if contacts.enough_touching and not contacts.all_touching:
            return self._without_the_others(stamp, contacts, carried, grasp_force)
        if not (self.config.cones and self._k > 2 and contacts.all_touching) or carried is None:
            self._past = None
            return self.solve(contacts)
        # The pyramids turn with the grasp, so that f* does not depend on its pose in the palm.
        frames, turns = grasp_frames(contacts.positions, contacts.rotations)
        turned = carried._replace(load=in_palm(turns, carried.load, 1.0))
        grasp = Contacts(contacts.positions, frames)
        optimal = self.solve(grasp, self._cones(stamp, turned, grasp_force))
        return optimal._replace(forces=in_contacts(turns, optimal.forces))

    def _cones(self, stamp: int, carried: CarriedLoad, grasp_force: float) -> Cones | None:
        """Return the cones for a load per newton of grasp force, or None without a load.

        f* must hold the worst recent load on each side of the pyramids: a shape that follows an
        oscillating load would always be late.
        """
        load, friction, reserve = carried
        if not (grasp_force > 0.0 and all_finite(load)):
            self._past = None
            return None
        worst, elapsed = reaches(load, friction), 0.0
        if self._past is not None:
            elapsed = 1e-9 * (stamp - self._past[0])
            keep = math.exp(-elapsed / self.config.load_memory)
            worst = np.maximum(worst, worst + keep * (self._past[1] - worst))
        self._past = stamp, worst
        wanted = with_reserve(worst, friction, reserve) / (_RELAXED * grasp_force)
        return Cones(friction, load / grasp_force, elapsed, wanted)

    def _without_the_others(
        self, stamp: int, contacts: Contacts, carried: CarriedLoad | None, grasp_force: float
    ) -> OptimalForces:
        """Return f* of a hand with only the fingers that touch; see `step`."""
        touching = contacts.touching
        part = self._parts.get(touching.tobytes())
        if part is None:
            weights = self._weights.reshape(-1, 3)[touching].ravel().tolist()
            config = self.config.model_copy(update={"weights": weights})
            part = ForceOptimizer(config, int(touching.sum()))
            self._parts[touching.tobytes()] = part
        seen = None if carried is None else CarriedLoad(*(each[touching] for each in carried))
        optimal = part.step(stamp, contacts.part(touching), seen, grasp_force)
        whole = np.zeros((self._k, 3)) if optimal.ok else np.full((self._k, 3), np.nan)
        whole[touching] = optimal.forces
        return optimal._replace(forces=whole)

    def solve(self, contacts: Contacts, cones: Cones | None = None) -> OptimalForces:
        """Return the distribution of a unit internal force; by default (13) has no cones."""
        if not contacts.all_touching:
            missing = ", ".join(str(i + 1) for i in np.flatnonzero(~contacts.touching))
            needed = "all" if self._k <= MIN_CONTACTS else "at least three"
            return self._without_answer(
                Status.CONTACT_MISSING, f"no contact at finger {missing}; {needed} must touch (A7)"
            )
        points, rotations = contacts.positions, contacts.rotations
        if self._k == 2:
            return self._opposed(points, rotations)
        if collinearity_margin(points) < MIN_COLLINEARITY_MARGIN:
            return self._without_answer(
                Status.COLLINEAR,
                "the contacts lie on one line, no moment about it can balance (A7)",
            )
        balance = scaled_balance(points, rotations)
        self._problem.equal[:6] = balance.T
        found = self._program.solve(self._problem)
        if not found.residual < _MAX_RESIDUAL:
            self._shape = None
            if "primal infeasible" in found.osqp_status:
                return self._without_answer(Status.UNBALANCED, _UNBALANCED)
            return self._without_answer(
                Status.FAILED,
                f"OSQP ended with '{found.osqp_status}' after {found.iterations} iterations, and "
                f"the best residual is {found.residual:.1e}; the last answer is not used",
            )
        how = found.residual, found.iterations, found.solve_time
        optimal = OptimalForces(Status.SOLVED, "", found.x.reshape(self._k, 3), *how)
        if cones is not None:
            return self._inside(optimal, balance, cones)
        self._shape = None
        return optimal

    def _opposed(self, points: Array, rotations: Array) -> OptimalForces:
        """Return f* of two contacts, which can only press along the line between them."""
        along = points[1] - points[0]
        forces = np.stack([along, -along])
        forces = in_contacts(rotations, forces / np.linalg.norm(along))
        if not (forces[:, 1] > 0.0).all():
            return self._without_answer(Status.UNBALANCED, _UNBALANCED)
        return OptimalForces(Status.SOLVED, "", forces / forces[:, 1].sum(), 0.0)

    def _inside(self, paper: OptimalForces, balance: Array, cones: Cones) -> OptimalForces:
        """Return f* inside the cones; a solution of (13) that lies inside stays.

        It follows the optimum steadily, see `followed`; the first one applies immediately.
        """
        optimum, residual, shaped = paper.forces, paper.residual, False
        if not cones.holds(optimum):
            forces, missing = self._shaper.solve(balance, cones)
            if missing < _MAX_CONE_RESIDUAL:
                optimum, residual, shaped = forces, missing, True
        forces, before, time = optimum, self._shape, self.config.shape_time
        if before is not None and time > 0.0 and cones.elapsed > 0.0:
            fraction = 1.0 - math.exp(-cones.elapsed / time)
            touch = cones.load, cones.usable_friction
            forces = followed(before, optimum, balance, *touch, fraction)
        self._shape = forces
        residual = max(residual, imbalance(forces, balance))
        margin = cones.margin(forces)
        return paper._replace(forces=forces, residual=residual, cone_margin=margin, shaped=shaped)

    def _set_up(self) -> None:
        k, minimum = self._k, self.config.minimum_normal
        equal, right, rows = np.zeros((7, 3 * k)), np.zeros(7), np.zeros((k, 3 * k))
        equal[6, 1::3] = right[6] = 1.0
        rows[:, 1::3], bounds = -np.eye(k), np.full(k, -minimum)
        equal[:6] = 1.0  # G~, which each tick replaces
        self._problem = Problem(self._weights, np.zeros(3 * k), equal, right, rows, bounds)
        is_exact = self.config.solver == "exact"
        self._program = QuadraticProgram(self._problem, is_exact)
        self._shaper = ConeOptimizer(self._weights, minimum, is_exact)
        self._shape = None
        self._parts: dict[bytes, ForceOptimizer] = {}  # of the fingers that touch, by their mask

    def _without_answer(self, status: Status, reason: str) -> OptimalForces:
        return OptimalForces(status, reason, np.full((self._k, 3), np.nan))


@compiled
def scaled_balance(points: Array, rotations: Array) -> Array:
    """Return G~^T of (11) for forces in contact frames, shape (3k, 6).

    Its torques are divided by the size of the grasp, so that all rows have one magnitude. This does
    not change G~ f = 0.
    """
    arms = centered(points)
    arms /= math.sqrt((arms * arms).sum() / len(points))
    return grasp_map(arms, rotations).T
