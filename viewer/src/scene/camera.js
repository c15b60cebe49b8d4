// SPDX-License-Identifier: Apache-2.0
// Where to look from: an oblique view in which the fingers are far apart, and the usual four.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const ELEVATION = 22;
const FILLED = 0.86; // of the height or width of the picture

export class View {
  /** `points` must be in the picture at all times, `tips` are the fingertips at the start. */
  constructor(canvas, points, tips) {
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.points = points;
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.oblique = azimuth(tips);
    this.last = "oblique";
  }

  /** Look from a direction: oblique, front, side or top. */
  look(name) {
    const [turn, lift] = { oblique: [this.oblique, ELEVATION], front: [-90, 4], side: [0, 4], top: [-90, 89.9] }[name];
    this.last = name;
    const [a, e] = [turn, lift].map(THREE.MathUtils.degToRad);
    this.towards = new THREE.Vector3(Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e));
    this._fit();
  }

  resize(width, height) {
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.towards && this._untouched()) this._fit();
  }

  _untouched() {
    return this.camera.position.distanceTo(this._placed) < 1e-9;
  }

  /** Choose target and distance so that all points just fit; perspective makes them depend on each other. */
  _fit() {
    const tan = Math.tan(THREE.MathUtils.degToRad(this.camera.fov / 2));
    const [right, up] = basis(this.towards);
    const centre = new THREE.Box3().setFromPoints(this.points).getCenter(new THREE.Vector3());
    let distance = 4 * new THREE.Box3().setFromPoints(this.points).getSize(new THREE.Vector3()).length();
    for (let i = 0; i < 12; i++) {
      const seen = this.points.map((point) => {
        const arm = point.clone().sub(centre);
        const depth = tan * (distance - arm.dot(this.towards));
        return [arm.dot(right) / (depth * this.camera.aspect), arm.dot(up) / depth];
      });
      const [x, y] = [0, 1].map((axis) => limits(seen.map((place) => place[axis])));
      centre.addScaledVector(right, (x.middle * distance * tan * this.camera.aspect)).addScaledVector(up, y.middle * distance * tan);
      distance *= Math.max(x.half, y.half) / FILLED;
    }
    this.camera.position.copy(centre).addScaledVector(this.towards, distance);
    this.controls.target.copy(centre);
    this.controls.update();
    this._placed = this.camera.position.clone();
  }
}

function limits(values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return { middle: (low + high) / 2, half: (high - low) / 2 };
}

function basis(towards) {
  const right = new THREE.Vector3(0, 0, 1).cross(towards).normalize();
  return [right, towards.clone().cross(right)];
}

/** Return the oblique azimuth in degrees at which fingers are apart and none hides the object. */
function azimuth(tips) {
  if (tips.length < 2) return -55;
  const middle = tips.reduce((sum, tip) => sum.add(tip), new THREE.Vector3()).divideScalar(tips.length);
  const around = tips.map((tip) => tip.clone().sub(middle));
  const size = Math.max(...around.map((arm) => arm.length())) || 1;
  const worth = (degrees) => {
    const a = THREE.MathUtils.degToRad(degrees);
    const places = around.map((arm) => arm.y * Math.cos(a) - arm.x * Math.sin(a)).sort((x, y) => x - y);
    const apart = Math.min(...places.slice(1).map((place, i) => place - places[i]));
    const before = around.map((arm) => {
      const front = Math.max(0, arm.x * Math.cos(a) + arm.y * Math.sin(a));
      const beside = Math.abs(arm.y * Math.cos(a) - arm.x * Math.sin(a));
      return front * Math.max(0, 1 - beside / (0.7 * size));
    });
    return Math.round((1000 * (apart - Math.max(...before))) / size);
  };
  const oblique = Array.from({ length: 72 }, (_, i) => 5 * i - 180).filter((v) => (((v % 90) + 90) % 90) >= 20 && (((v % 90) + 90) % 90) <= 70);
  oblique.sort((a, b) => Math.abs(a + 65) - Math.abs(b + 65));
  return oblique.reduce((best, v) => (worth(v) > worth(best) ? v : best));
}
