// SPDX-License-Identifier: Apache-2.0
// One contact: its frame, the force on the object, and the cone in which the force must stay.

import * as THREE from "three";
import { segments } from "./lines.js";
import { triad } from "./triad.js";

const STEEPEST = 2.5; // friction above which a cone is drawn no wider
const ROUND = 48;
const UP = new THREE.Vector3(0, 1, 0);

export class ContactModel {
  /** `size` is a length in m that suits the scene, `scale` the length of one newton in m. */
  constructor(color, size, scale, axes) {
    this.color = color;
    this.scale = scale;
    this.least = 0.4 * size;
    this.group = new THREE.Group();
    this.frame = triad(0.42 * size, axes);
    this.frame.renderOrder = 6;
    this.cone = makeCone();
    this.arrow = makeArrow(0.045 * size);
    this.group.add(this.frame, this.cone.group, this.arrow.group);
  }

  paint(theme) {
    const color = theme.data(this.color);
    this.cone.material.color.set(color);
    this.cone.rim.material.color.set(color);
    this.arrow.material.color.set(theme.get("ink"));
  }

  /** Show the contact of a tick; force in N in the contact frame, y is the normal. */
  show(position, quaternion, force, friction, visible) {
    const touching = Number.isFinite(position[0]) && Number.isFinite(quaternion[0]);
    this.group.visible = touching;
    if (!touching) return;
    this.group.position.set(...position);
    this.group.quaternion.set(...quaternion);
    this.frame.visible = visible.frames;
    this._showCone(force[1], friction, visible.cones);
    this.arrow.show(force, this.scale, visible.forces);
  }

  _showCone(normal, friction, visible) {
    const known = Number.isFinite(friction) && friction > 0;
    this.cone.group.visible = visible && known;
    if (!this.cone.group.visible) return;
    // As high as the normal force is long: the arrow ends on the disc that closes the cone.
    const height = Math.max(this.least * 0.25, this.scale * Math.max(0, normal || 0));
    const width = height * Math.min(friction, STEEPEST);
    this.cone.group.scale.set(width, height, width);
  }
}

function makeCone() {
  const geometry = new THREE.ConeGeometry(1, 1, ROUND, 1, true).rotateX(Math.PI).translate(0, 0.5, 0);
  const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.2, side: THREE.DoubleSide, forceSinglePass: true, depthWrite: false });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.renderOrder = 3;
  const around = Array.from({ length: ROUND }, (_, i) => [i, i + 1].flatMap((k) => {
    const angle = (2 * Math.PI * k) / ROUND;
    return [Math.cos(angle), 1, Math.sin(angle)];
  })).flat();
  const rim = segments(around, { linewidth: 1.6, transparent: true, opacity: 0.85 });
  rim.renderOrder = 4;
  return { group: new THREE.Group().add(mesh, rim), material, rim };
}

/** Make an arrow along y; `show(force, scale, visible)` turns it along a force. */
export function makeArrow(radius) {
  const material = new THREE.MeshLambertMaterial();
  const shaft = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 1, 16).translate(0, 0.5, 0), material);
  const head = new THREE.Mesh(new THREE.ConeGeometry(2.5 * radius, 6 * radius, 24).translate(0, -3 * radius, 0), material);
  const group = new THREE.Group().add(shaft, head);
  const along = new THREE.Vector3();
  const show = (force, scale, visible) => {
    along.set(...force).multiplyScalar(scale);
    const length = along.length();
    group.visible = visible && Number.isFinite(length) && length > 1e-4;
    if (!group.visible) return;
    const head6 = Math.min(6 * radius, 0.6 * length);
    head.scale.setScalar(head6 / (6 * radius));
    head.position.y = length;
    shaft.scale.y = Math.max(1e-4, length - head6);
    group.quaternion.setFromUnitVectors(UP, along.divideScalar(length));
  };
  return { group, material, show };
}
