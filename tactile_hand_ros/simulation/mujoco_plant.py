# SPDX-License-Identifier: Apache-2.0
"""The plant with MuJoCo as its physics engine (Todorov, Erez and Tassa 2012).

The model is built from Pinocchio's model of the hand, since MuJoCo's URDF reader ignores <mimic>.
`Plant` keeps the state; a step writes it into MuJoCo, and reads it back.

MuJoCo replaces contact laws by soft constraints. What is exact in `Plant` and soft here:

- A tip touches from a gap of 1 um on and sinks in under load, whatever `contact.compliance`.
  Impacts take a few steps.
- A contact that sticks creeps in proportion to its tangential force, and drifts where it rolls;
  `slid` counts both. A contact that slides lifts off and comes back within a step.
- Joints overshoot their limits, joints that follow others lag within a step, and joints held by
  their friction creep.
- Positions are of first order in the time step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.extras import optional
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import (
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from tactile_hand_ros.simulation.contact_step import TOUCH, Motion, contact_geometry, velocity_map
from tactile_hand_ros.simulation.coulomb import EXACT, UNSOLVED
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import ObjectConfig, PlantConfig

_OBJECT = "object of the plant"  # no finger has a name with spaces
# A contact that slides lifts off and has no force for a step, again and again. Without substeps, a
# third of the steps were open at 50 mm/s; with them, none, and the means vary by 10 %.
_SUBSTEPS = 10
# The part of an acceleration that a constraint cancels. The rest lets a loaded tip sink in. It must
# sink in deeper than rolling lifts it, or its force is interrupted, as at 0.9999 in `pull`.
_IMPEDANCE = 0.99
# The same of coupled joints, the largest: light links sag in between; and of joints that friction
# holds, which creep the less.
_COUPLED = 0.9999
_FRICTION_TO_NORMAL = 100.0  # end of the recommended range; creep is that much slower
_TOLERANCE = 1e-12  # of the solver; an iteration more than with 1e-8
_ITERATIONS = 100


class MujocoPlant(Plant):
    """A plant whose steps MuJoCo computes; `contact_residual` is NaN."""

    def __init__(self, config: PlantConfig) -> None:
        """Build hand and object in their initial state; see `Plant`.

        Raises:
            MissingLibraryError: If MuJoCo is not installed.
        """
        self._mj = optional("mujoco", "plant.engine: mujoco", package="mujoco-core")
        # Its warnings would go to a file in the working directory; `drive` reports divergence.
        self._mj.set_mju_user_warning(lambda text: None)
        super().__init__(config)
        self._build()

    def configure(self, config: PlantConfig) -> None:
        """Change friction and mass of the object; see `Plant`."""
        super().configure(config)
        self._build()

    def _build(self) -> None:
        inertia = self._world.inertia
        self._model = model = _Builder(self._mj, self.hand, self.config, inertia).build()
        self._data = self._mj.MjData(model)
        # The object comes last, so angle and rate of a joint have the same index.
        self._driven = [model.joint(name).qposadr[0] for name in self.hand.joint_names]
        self._following = [
            (model.joint(name).qposadr[0], model.joint(c.joint).qposadr[0], c.ratio, c.offset)
            for name, c in self.hand.couplings.items()
        ]
        self._tips = {model.geom(name).id: i for i, name in enumerate(self.hand.finger_names)}
        self._pairs = [model.pair(name).id for name in self.hand.finger_names]

    def _moved(self, h: float, turns: Array | None, wrench: Array) -> Motion:
        """Return hand and object a step later; see `Plant`."""
        model, data, now = self._model, self._data, self._now
        self._write(now)
        data.qfrc_applied[self._driven] = self._acting if turns is None else self._acting - turns
        data.xfrc_applied[-1] = wrench - self._weight
        model.opt.gravity = self.hand.gravity
        model.pair_friction[self._pairs, :2] = self.friction[:, None]
        torsion = self._world.torsion
        model.pair_friction[self._pairs, 2] = torsion * self.friction
        forces, outcome = np.zeros((self.hand.fingers, 4 if torsion > 0.0 else 3)), EXACT
        for _ in range(_SUBSTEPS):
            self._mj.mj_step(model, data)
            self._add_forces(forces)
            if data.solver_niter[: data.nisland].max(initial=0) >= _ITERATIONS:
                outcome = UNSOLVED
        theta, rates = data.qpos[self._driven], data.qvel[self._driven]
        position, (w, x, y, z) = data.qpos[-7:-4].copy(), data.qpos[-4:]
        rotation = rotation_from_quaternion([x, y, z, w])
        v = np.concatenate([rates, data.qvel[-6:-3], rotation @ data.qvel[-3:]])
        # Forces and sliding are means over the step, in the contact frames at its middle.
        turn = vector_from_rotation(rotation @ now.rotation.T)
        mean = np.concatenate([theta - now.theta, position - now.position, turn]) / h
        there = 0.5 * (position + now.position), rotation_from_vector(0.5 * turn) @ now.rotation
        tips = self.hand.fingertips(0.5 * (theta + now.theta))
        points, frames, _ = contact_geometry(self._world, *there, tips.positions)
        rows = velocity_map(tips, there[0], points, frames, torsion)
        impulses = h / _SUBSTEPS * forces
        impulses[:, :3] = np.einsum("ij,ijk->ik", impulses[:, :3], frames)
        loaded = impulses[:, 1] > 0.0
        sliding = np.where(loaded[:, None], (rows @ mean)[:, :3:2], 0.0)
        slid = now.slid + h * np.hypot(sliding[:, 0], sliding[:, 1])
        contacts = rows, impulses, sliding, loaded, slid, np.nan, outcome
        return Motion(theta, v, position, rotation, now.velocities, *contacts)

    def _write(self, now: Motion) -> None:
        """Set the state of MuJoCo, with the joints that follow exactly where they belong."""
        data, m = self._data, self.hand.joints
        if not self._steps:  # forget the last solution, so that equal runs have equal bits
            self._mj.mj_resetData(self._model, data)
        v = now.velocities
        data.qpos[self._driven], data.qvel[self._driven] = now.theta, v[:m]
        for i, j, ratio, offset in self._following:
            data.qpos[i], data.qvel[i] = ratio * data.qpos[j] + offset, ratio * data.qvel[j]
        data.qpos[-7:-4], data.qpos[-4:] = now.position, _quaternion(now.rotation)
        # The angular velocity of a free body is in its own axes.
        data.qvel[-6:-3], data.qvel[-3:] = v[m : m + 3], now.rotation.T @ v[m + 3 :]

    def _add_forces(self, forces: Array) -> None:
        """Add the forces of a substep on the object, palm axes, shape (k, 3), N.

        With a torsion, shape (k, 4), the last one is the moment about the normal over it.
        """
        force, axes = np.zeros(6), self._data.contact.frame.reshape(-1, 3, 3)
        # MuJoCo orders geometries by type: the tip comes first, and the force acts on the second.
        for i, tip in enumerate(self._data.contact.geom[:, 0].tolist()):
            self._mj.mj_contactForce(self._model, self._data, i, force)
            forces[self._tips[tip], :3] += force[:3] @ axes[i]
            if self._world.torsion > 0.0:
                forces[self._tips[tip], 3] += force[3] / self._world.torsion


class _Builder:
    """Translates hand and object into a model of MuJoCo."""

    def __init__(self, mj: Any, hand: Hand, config: PlantConfig, inertia: Array) -> None:
        self._mj, self._hand, self._config, self._inertia = mj, hand, config, inertia
        self._spec = mj.MjSpec()
        # Time constant and damping ratio. With the shortest time constant, two substeps, the forces
        # of sliding contacts vary twice as much; a longer one makes contacts softer.
        self._solref = [config.time_step, 1.0]
        self._solimp = [_IMPEDANCE, _IMPEDANCE, 1.0, 0.5, 1.0]  # at any depth
        self._stiff = [_COUPLED, _COUPLED, 1.0, 0.5, 1.0]
        self._masses: list[tuple[float, Array]] = []

    def build(self) -> Any:
        """Return the compiled model."""
        self._set_options()
        self._add_hand()
        self._add_object()
        model = self._spec.compile()
        for i, (mass, moments) in enumerate(self._masses, start=1):
            model.body_mass[i], model.body_inertia[i] = mass, moments
        hand = self._hand.model
        for i, name in enumerate(hand.names[1:] if self._hand.has_losses else ()):
            dof = model.joint(name).dofadr[0]
            model.dof_damping[dof], model.dof_frictionloss[dof] = hand.damping[i], hand.friction[i]
            model.dof_solref[dof], model.dof_solimp[dof] = self._solref, self._stiff
        self._mj.mj_setConst(model, self._mj.MjData(model))
        return model

    def _set_options(self) -> None:
        mj, option = self._mj, self._spec.option
        self._spec.compiler.degree = False
        option.timestep = self._config.time_step / _SUBSTEPS
        option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST  # a spinning body gains no energy
        option.cone = mj.mjtCone.mjCONE_ELLIPTIC  # round, as Coulomb's
        option.impratio = _FRICTION_TO_NORMAL
        option.tolerance, option.iterations = _TOLERANCE, _ITERATIONS
        # The default estimates softness for stretched fingers: a hold needed twice the force.
        option.enableflags |= mj.mjtEnableBit.mjENBL_DIAGEXACT
        # A simulation that diverges must not start again unnoticed.
        option.disableflags |= mj.mjtDisableBit.mjDSBL_AUTORESET

    def _add_hand(self) -> None:
        hand, model, joint = self._hand, self._hand.model, self._mj.mjtJoint
        data, bodies = model.createData(), [self._spec.worldbody]
        pin.computeJointJacobians(model, data, pin.neutral(model))
        limits = dict(zip(hand.joint_names, np.transpose(hand.position_limits), strict=True))
        for i, name in list(enumerate(model.names))[1:]:
            place, link = model.jointPlacements[i], model.inertias[i]
            at = {"pos": place.translation, "quat": _quaternion(place.rotation)}
            body = bodies[model.parents[i]].add_body(**at)
            along, about = pin.getJointJacobian(model, data, i, pin.LOCAL)[:, i - 1].reshape(2, 3)
            kind, axis = (joint.mjJNT_SLIDE, along) if along.any() else (joint.mjJNT_HINGE, about)
            made = body.add_joint(name=name, type=kind, axis=axis)
            if name in limits and np.isfinite(limits[name]).all():
                made.limited, made.range = True, limits[name]
                made.solref_limit, made.solimp_limit = self._solref, self._solimp
            self._put_mass(body, link.mass, link.lever, link.inertia)
            bodies.append(body)
        for index, name, radius in zip(hand.tip_frames, hand.finger_names, hand.radii, strict=True):
            frame, sphere = model.frames[index], self._mj.mjtGeom.mjGEOM_SPHERE
            at = {"pos": frame.placement.translation, "size": [radius, 0.0, 0.0]}
            bodies[frame.parentJoint].add_geom(name=name, type=sphere, **at, **_NO_CONTACT)
        for name, c in hand.couplings.items():
            law = {"type": self._mj.mjtEq.mjEQ_JOINT, "name1": name, "name2": c.joint}
            made = self._spec.add_equality(**law, solref=self._solref, solimp=self._stiff)
            made.data[:2] = c.offset, c.ratio  # of a polynomial

    def _add_object(self) -> None:
        body = self._spec.worldbody.add_body()
        body.add_freejoint()
        self._put_mass(body, self._config.object.mass, np.zeros(3), self._inertia)
        _add_shape(self._mj, self._spec, body, self._config.object)
        for name in self._hand.finger_names:
            size = 4 if self._config.contact.torsion > 0.0 else 3
            pair = {"geomname1": name, "geomname2": _OBJECT, "condim": size}
            soft = {"solref": self._solref, "solimp": self._solimp}
            # From the gap that counts as touching; else tips at rest pass a substep without force.
            self._spec.add_pair(name=name, **pair, **soft, margin=TOUCH)

    def _put_mass(self, body: Any, mass: float, center: Array, inertia: Array) -> None:
        """Set the inertia of a body; mass and moments wait for the compiled model.

        The compiler rejects links without mass and the moments that the paper prints.
        """
        moments, axes = np.linalg.eigh(inertia)
        body.ipos, body.iquat = center, _quaternion(axes * np.linalg.det(axes))
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
        self._masses.append((mass, moments))


_NO_CONTACT = {"contype": 0, "conaffinity": 0}  # but for pairs


def _add_shape(mj: Any, spec: Any, body: Any, config: ObjectConfig) -> None:
    """Give a body the shape of the object."""
    named, half = {"name": _OBJECT, **_NO_CONTACT}, 0.5 * np.array(config.size)
    radius, height = half[0], half[2]
    if config.vertices or config.mesh:
        spec.add_mesh(name=_OBJECT, uservert=config.solid().vertices.ravel())
        body.add_geom(type=mj.mjtGeom.mjGEOM_MESH, meshname=_OBJECT, **named)
        return
    kind, size = {
        "box": (mj.mjtGeom.mjGEOM_BOX, half),
        "cylinder": (mj.mjtGeom.mjGEOM_CYLINDER, [radius, height, 0.0]),
        "sphere": (mj.mjtGeom.mjGEOM_SPHERE, [radius, 0.0, 0.0]),
        "capsule": (mj.mjtGeom.mjGEOM_CAPSULE, [radius, height - radius, 0.0]),
    }[config.shape]
    body.add_geom(type=kind, size=size, **named)


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion of a rotation, shape (3, 3), in the order of MuJoCo: w, x, y, z."""
    return np.roll(quaternion_from_rotation(rotation), 1)


def make_plant(config: PlantConfig) -> Plant:
    """Return a plant with the physics engine of its parameters; see `Plant` for its errors.

    Raises:
        MissingLibraryError: If that engine is not installed.
    """
    return MujocoPlant(config) if config.engine == "mujoco" else Plant(config)
