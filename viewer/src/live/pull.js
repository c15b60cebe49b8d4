// SPDX-License-Identifier: Apache-2.0
// Hands on the object: a spring from any point of it to the mouse, and the handles of the goal.

import * as THREE from "three";
import { TransformControls } from "three/addons/controls/TransformControls.js";
import { rowOf } from "../data.js";
import { segments } from "../scene/lines.js";

const PERIOD = 33; // ms between two commands of a drag; a push is renewed as often
const SHOWN = 300; // ms until a goal that was commanded is shown, or refused
const GONE = 500; // ms without a contact
const WIDTHS = 4; // object radii that the mouse moves for the largest force

/** Lets a pointer pull at the object of a scene; `shown(force)` is called with N, null at the end. */
export class Spring {
  constructor(scene, source, canvas, shown) {
    Object.assign(this, { scene, source, canvas, shown });
    this.largest = source.run.push;
    const radius = Math.max(...source.run.object.vertices.map((corner) => Math.hypot(...corner)));
    this.stiffness = this.largest / (WIDTHS * radius);
    this.line = segments([0, 0, 0, 0, 0, 1], { linewidth: 4 });
    this.line.renderOrder = 9;
    this.line.material.depthTest = false;
    this.line.visible = false;
    scene.scene.add(this.line);
    scene.theme.listen(() => this.paint());
    this.paint();
    this.wanted = () => true;
    // Before the camera's own listeners, which are those of the canvas itself.
    canvas.parentElement.addEventListener("pointerdown", (event) => this._down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this._move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, () => this.release());
  }

  paint() {
    this.line.material.color.set(this.scene.theme.event("disturbance"));
  }

  get holds() {
    return Boolean(this.point);
  }

  /** Return a ray from the camera through a pointer. */
  _ray(event) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const place = new THREE.Vector2(((event.clientX - left) / width) * 2 - 1, 1 - ((event.clientY - top) / height) * 2);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(place, this.scene.view.camera);
    return ray;
  }

  _down(event) {
    const { solid, view } = this.scene;
    if (event.target !== this.canvas || event.button !== 0 || !solid?.known || !this.wanted()) return;
    solid.group.updateMatrixWorld(true);
    const meshes = solid.group.children.filter((part) => part.isMesh);
    const hit = this._ray(event).intersectObjects(meshes, false)[0];
    if (!hit) return;
    event.stopPropagation();
    this.canvas.setPointerCapture(event.pointerId);
    const normal = view.camera.getWorldDirection(new THREE.Vector3());
    this.grab(hit.point, new THREE.Plane().setFromNormalAndCoplanarPoint(normal, hit.point));
  }

  /** Hold the object at a point, palm frame, m; a pointer moves in `plane`. */
  grab(point, plane = null) {
    this.point = this.scene.solid.group.worldToLocal(point.clone());
    this.plane = plane;
    this.target = point.clone();
    this.touched = performance.now();
    this.timer = setInterval(() => this._renew(), PERIOD);
  }

  _move(event) {
    if (!this.plane) return;
    const there = this._ray(event).ray.intersectPlane(this.plane, new THREE.Vector3());
    if (there) this.target = there;
    this._renew(true);
  }

  /** Send the force of the spring, at most once in a period. */
  _renew(moved = false) {
    const now = performance.now();
    if (!this.holds || (moved && now - this.sent < PERIOD / 2)) return;
    this.sent = now;
    const { solid } = this.scene;
    if (this._touched()) this.touched = now;
    if (now - this.touched > GONE) {
      this.release(); // it has left the hand: nothing would balance the pull
      return;
    }
    const from = solid.group.localToWorld(this.point.clone());
    const force = this.target.clone().sub(from).multiplyScalar(this.stiffness).clampLength(0, this.largest);
    const torque = from.clone().sub(solid.group.position).cross(force);
    this.source.ask({ do: "push", wrench: [...force.toArray(), ...torque.toArray()] }).then(({ ok }) => ok || this.release());
    this._show(from, force);
    this.shown(force.length());
  }

  _touched() {
    const { columns } = this.source.run;
    return rowOf(columns.contact_positions, columns.time.rows - 1).some(Number.isFinite);
  }

  _show(from, force) {
    this.line.visible = force.length() > 0;
    this.line.position.copy(from);
    this.line.scale.setScalar(this.target.distanceTo(from) || 1e-6);
    this.line.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), force.clone().normalize());
    this.scene.invalidate();
  }

  release() {
    if (!this.holds) return;
    clearInterval(this.timer);
    this.point = this.plane = null;
    this.line.visible = false;
    this.source.ask({ do: "push", wrench: [0, 0, 0, 0, 0, 0] });
    this.shown(null);
    this.scene.invalidate();
  }
}

/** The handles of the goal: while they are not dragged, they are where the hand goes. */
export class Handles {
  constructor(scene, source, canvas, refused) {
    Object.assign(this, { scene, source, refused, sent: 0 });
    this.proxy = new THREE.Object3D();
    scene.scene.add(this.proxy);
    this.controls = new TransformControls(scene.view.camera, canvas);
    this.controls.size = 0.7;
    this.helper = this.controls.getHelper();
    scene.scene.add(this.helper);
    this.controls.addEventListener("change", () => scene.invalidate());
    this.controls.addEventListener("dragging-changed", ({ value }) => this._dragging(value));
    this.controls.addEventListener("objectChange", () => performance.now() - this.sent > PERIOD && this.send());
    this.show(null);
  }

  /** Show the handles that "translate" or "rotate", or none. */
  show(mode) {
    this.mode = mode;
    if (mode) this.controls.setMode(mode);
    if (mode) this.controls.attach(this.proxy);
    else this.controls.detach();
    this.scene.invalidate();
  }

  get busy() {
    return this.controls.dragging || (Boolean(this.mode) && this.controls.axis !== null);
  }

  /** Follow the goal, or the grasp before there is one. */
  follow() {
    if (this.controls.dragging || !this.mode || performance.now() - this.sent < SHOWN) return;
    const { columns } = this.source.run;
    const row = this.scene.row;
    for (const name of ["desired", "auxiliary"]) {
      const [p, q] = [rowOf(columns[`${name}_position`], row), rowOf(columns[`${name}_quaternion`], row)];
      if (!Number.isFinite(p[0]) || !Number.isFinite(q[0])) continue;
      this.proxy.position.set(...p);
      this.proxy.quaternion.set(...q);
      return;
    }
  }

  _dragging(value) {
    this.scene.view.controls.enabled = !value;
    if (!value) this.send();
  }

  /** Command the pose of the handles. */
  send() {
    this.sent = performance.now();
    const command = { do: "pose", position: this.proxy.position.toArray(), quaternion: this.proxy.quaternion.toArray() };
    this.source.ask(command).then(({ ok, text }) => ok || this.refused(text));
  }
}
