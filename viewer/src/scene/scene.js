// SPDX-License-Identifier: Apache-2.0
// The 3D view: puts a tick of the record on the screen whenever something has changed.

import * as THREE from "three";
import { rowAt, rowOf } from "../data.js";
import { View } from "./camera.js";
import { ContactModel, makeArrow } from "./contact.js";
import { Ground } from "./ground.js";
import { HandModel } from "./hand.js";
import { Badge } from "./label.js";
import { Sharpness } from "./sharpness.js";
import { Ghost, Solid } from "./solid.js";
import { Trail } from "./trail.js";
import { triad } from "./triad.js";

const SLIP = 2; // state of a contact in the record
const SAMPLES = 12; // ticks that decide what must be in the picture

export class Scene {
  constructor(canvas, run, axes, theme) {
    this.run = run;
    this.theme = theme;
    this.visible = { object: true, forces: true, cones: true, frames: true, goal: true, trail: true };
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.scene = new THREE.Scene();
    this.frames = 0;
    this.sharpness = new Sharpness();
    this._build(axes);
    this._light();
    this.view = new View(canvas, this._extent(), this._tips());
    this.view.look("oblique");
    this._listenToControls();
    theme.listen(() => this._paint());
    this._paint();
    this.show(0);
  }

  _build(axes) {
    const { run } = this;
    this.hand = run.hand ? new HandModel(run.hand, run.fingers) : null;
    const size = this.hand ? 3 * this.hand.radius : spread(run) * 0.6;
    this.size = size;
    this.newton = (0.7 * size) / (strongest(run.columns.force) || 1);
    this.contacts = run.fingers.map((finger) => new ContactModel(finger.color, size, this.newton, axes));
    this.solid = run.object && known(run.columns.object_position) ? new Solid(run.object) : null;
    this.ghost = this.solid ? new Ghost(run.object, size) : null;
    this.goal = triad(0.55 * size, axes, 3);
    this.grasp = triad(0.55 * size, axes, 3);
    this.trail = new Trail(run.columns.auxiliary_position);
    this.ground = new Ground(size / 2, 12);
    this.push = run.columns.push ? makeArrow(0.06 * size) : null;
    if (this.push) this.scene.add(this.push.group);
    this.palm = triad(0.7 * size, axes, 2.5);
    this.palm.material.depthTest = false; // it lies in the spokes of the palm
    this.badges = this._badges();
    const parts = [this.hand, this.solid, this.ghost, this.trail, this.ground, ...this.contacts, ...this.badges];
    this.painted = parts.filter((part) => part);
    this.scene.add(...this.painted.map((part) => part.group), this.goal, this.grasp, this.palm);
  }

  _badges() {
    if (!this.hand) return [];
    this.hand.pose(rowOf(this.run.columns.theta, 0));
    return this.hand.tips.map((tip) => {
      const badge = new Badge(String(tip.finger + 1), tip.color, 0.42 * this.size);
      const base = this.hand.base(tip).getWorldPosition(new THREE.Vector3());
      const outward = base.clone().setZ(0);
      if (outward.length() > 1e-6) outward.setLength(0.55 * this.size);
      badge.group.position.copy(base.add(outward));
      return badge;
    });
  }

  _light() {
    this.sky = new THREE.HemisphereLight("#ffffff", "#9aa7b8", 1.7);
    this.sky.position.set(0, 0, 1);
    const sun = new THREE.DirectionalLight("#ffffff", 2.1);
    sun.position.set(-1.2, -1.6, 2.4);
    const fill = new THREE.DirectionalLight("#dfe9ff", 0.7);
    fill.position.set(2, 1, 0.5);
    this.scene.add(this.sky, sun, fill);
  }

  _listenToControls() {
    const { controls } = this.view;
    controls.addEventListener("change", () => this.invalidate());
    for (const [name, turning] of [["start", true], ["end", false]]) {
      controls.addEventListener(name, () => {
        this._turning = turning;
        this.invalidate();
      });
    }
  }

  /** Return points that should be in the picture, of some ticks of the whole run. */
  _extent() {
    const { columns } = this.run;
    const found = [];
    for (let i = 0; i <= SAMPLES; i++) {
      const row = Math.round((i / SAMPLES) * (columns.time.rows - 1));
      this.hand?.pose(rowOf(columns.theta, row));
      found.push(...(this.hand?.points() ?? []));
      for (const tip of this.hand?.tips ?? []) found.push(...around(tip.node.getWorldPosition(new THREE.Vector3()), tip.radius));
      // Of an object that no finger touches any more, the picture shows only how it leaves.
      if (this.solid && rowOf(columns.contact_positions, row).some(Number.isFinite)) {
        if (place(this.solid.group, columns.object_position, columns.object_quaternion, row, true)) found.push(...this.solid.corners());
      }
      for (const name of ["auxiliary_position", "contact_positions", "desired_position"]) {
        const values = rowOf(columns[name], row);
        for (let k = 0; k < values.length; k += 3) {
          if (Number.isFinite(values[k])) found.push(...around(new THREE.Vector3(...values.subarray(k, k + 3)), 0.3 * this.size));
        }
      }
    }
    for (const badge of this.badges) found.push(...around(badge.group.position, 0.5 * badge.size));
    if (!found.length) found.push(...around(new THREE.Vector3(), 1)); // nothing is known
    return found;
  }

  _tips() {
    this.hand?.pose(rowOf(this.run.columns.theta, 0));
    return this.hand?.tips.map((tip) => tip.node.getWorldPosition(new THREE.Vector3())) ?? [];
  }

  _paint() {
    for (const part of this.painted) part.paint(this.theme);
    this.push?.material.color.set(this.theme.event("disturbance"));
    this.sky.intensity = this.theme.dark ? 1.35 : 1.9;
    this.invalidate();
  }

  get _moving() {
    return this._playing || this._turning;
  }

  /** Show the tick at a time in s; while it plays, pictures may be coarser. */
  show(time, playing = false) {
    const { run } = this;
    this._playing = playing;
    const row = rowAt(run.time, time);
    this.row = row;
    this.hand?.pose(rowOf(run.columns.theta, row));
    this._showContacts(row);
    if (this.solid) this.solid.known = place(this.solid.group, run.columns.object_position, run.columns.object_quaternion, row, this.visible.object);
    place(this.goal, run.columns.desired_position, run.columns.desired_quaternion, row, this.visible.goal);
    place(this.grasp, run.columns.auxiliary_position, run.columns.auxiliary_quaternion, row, this.visible.frames);
    this._showGhost();
    if (this.push) this._showPush(row);
    this.trail.group.visible = this.visible.trail;
    this.trail.show(row);
    this.invalidate();
  }

  _showContacts(row) {
    const { columns, fingers } = this.run;
    const [positions, quaternions] = [rowOf(columns.contact_positions, row), rowOf(columns.contact_quaternions, row)];
    const [forces, friction, grip] = [rowOf(columns.force, row), rowOf(columns.friction, row), rowOf(columns.grip, row)];
    fingers.forEach((_, i) => {
      this.contacts[i].show(positions.subarray(3 * i, 3 * i + 3), quaternions.subarray(4 * i, 4 * i + 4), forces.subarray(3 * i, 3 * i + 3), friction[i], this.visible);
    });
    this.hand?.alarm(fingers.map((_, i) => grip[i] === SLIP));
  }

  /** The push at a row, at the point of its line of action that is nearest to the object's center. */
  _showPush(row) {
    const [x, y, z, ...torque] = rowOf(this.run.columns.push, row);
    const force = new THREE.Vector3(x, y, z);
    const from = force.clone().cross(new THREE.Vector3(...torque)).divideScalar(force.lengthSq() || 1);
    if (this.solid) from.add(this.solid.group.position);
    this.push.group.position.copy(from);
    this.push.show([x, y, z], this.newton, this.visible.forces && Boolean(this.solid?.known));
  }

  /** Let the largest of the forces that there are now fill the picture, if that changes much. */
  rescale() {
    const newton = (0.7 * this.size) / (strongest(this.run.columns.force) || 1);
    if (newton > 0.6 * this.newton && newton < 1.6 * this.newton) return;
    this.newton = newton;
    for (const contact of this.contacts) contact.scale = newton;
    this.rescaled?.();
  }

  /** The ghost is where the object would be if the grasp, as it is now, were at the goal. */
  _showGhost() {
    if (!this.ghost) return;
    const { group } = this.ghost;
    const grasp = matrixOf(this.run.columns.auxiliary_position, this.run.columns.auxiliary_quaternion, this.row);
    group.visible = this.goal.visible && this.solid.known && grasp !== null;
    if (!group.visible) return;
    this.goal.updateMatrix();
    this.solid.group.updateMatrix();
    group.matrixAutoUpdate = false;
    group.matrix.copy(this.goal.matrix).multiply(grasp.invert()).multiply(this.solid.group.matrix);
    group.matrixWorldNeedsUpdate = true;
  }

  /** Ask for one new picture, as soon as the browser can. */
  invalidate() {
    if (this._asked) return;
    this._asked = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this._asked = false;
    this._resize();
    this.renderer.render(this.scene, this.view.camera);
    this.frames += 1;
    this.sharpness.drawn(performance.now(), this._moving);
  }

  _resize() {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement;
    const ratio = Math.min(window.devicePixelRatio || 1, 2) * this.sharpness.share(this._moving);
    if (width === this._width && height === this._height && ratio === this._ratio) return;
    [this._width, this._height, this._ratio] = [width, height, ratio];
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.view.resize(width || 1, height || 1);
  }

  /** Return how many different colours a fresh picture has, which tells whether it is blank. */
  colours() {
    this.draw();
    const gl = this.renderer.getContext();
    const pixels = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
    gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return new Set(new Uint32Array(pixels.buffer)).size;
  }
}

/** Return the six points at a distance along the axes. */
function around(point, distance) {
  const shifts = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
  return shifts.map((shift) => new THREE.Vector3(...shift).multiplyScalar(distance).add(point));
}

/** Put an object where it is at a row; returns whether that is known. */
function place(object, positions, quaternions, row, wanted) {
  const [p, q] = [rowOf(positions, row), rowOf(quaternions, row)];
  const seen = Number.isFinite(p[0]) && Number.isFinite(q[0]);
  object.visible = wanted && seen;
  if (!seen) return false;
  object.position.set(...p);
  object.quaternion.set(...q);
  return true;
}

function known(array) {
  return array.values.some((value) => Number.isFinite(value));
}

function matrixOf(positions, quaternions, row) {
  const [p, q] = [rowOf(positions, row), rowOf(quaternions, row)];
  if (!Number.isFinite(p[0]) || !Number.isFinite(q[0])) return null;
  return new THREE.Matrix4().compose(new THREE.Vector3(...p), new THREE.Quaternion(...q), new THREE.Vector3(1, 1, 1));
}

/** Return a force in N that few ticks exceed. */
function strongest(forces) {
  const sizes = [];
  for (let i = 0; i + 2 < forces.rows * forces.width; i += 3) {
    const size = Math.hypot(forces.values[i], forces.values[i + 1], forces.values[i + 2]);
    if (size > 0) sizes.push(size);
  }
  sizes.sort((a, b) => a - b);
  return sizes[Math.floor(0.99 * (sizes.length - 1))] ?? 0;
}

/** Return how far contacts are from each other, m. */
function spread({ columns }) {
  for (let row = 0; row < columns.time.rows; row++) {
    const points = rowOf(columns.contact_positions, row);
    if (points.every((value) => Number.isFinite(value))) {
      const box = new THREE.Box3().setFromArray([...points]);
      return box.getSize(new THREE.Vector3()).length() / 2 || 0.1;
    }
  }
  return 0.1;
}
