// SPDX-License-Identifier: Apache-2.0
// The path of the grasp: all of it faint, what is behind us strong.

import * as THREE from "three";
import { segments } from "./lines.js";

const PIECES = 240;

export class Trail {
  constructor(array) {
    const rows = [];
    const step = Math.max(1, Math.floor(array.rows / PIECES));
    for (let row = 0; row < array.rows; row += step) if (Number.isFinite(array.values[3 * row])) rows.push(row);
    const points = rows.slice(1).flatMap((row, i) => [...at(array, rows[i]), ...at(array, row)]);
    this.rows = rows;
    this.group = new THREE.Group();
    if (points.length === 0) return;
    this.whole = segments(points, { linewidth: 1.4, transparent: true, opacity: 0.3 });
    this.done = segments(points, { linewidth: 3 });
    this.group.add(this.whole, this.done);
  }

  paint(theme) {
    for (const line of [this.whole, this.done]) line?.material.color.set(theme.get("goal"));
  }

  dispose() {
    for (const line of [this.whole, this.done]) line?.geometry.dispose();
    for (const line of [this.whole, this.done]) line?.material.dispose();
  }

  show(row) {
    if (!this.done) return;
    let count = 0;
    while (count + 1 < this.rows.length && this.rows[count + 1] <= row) count++;
    this.done.geometry.instanceCount = count;
    this.done.visible = count > 0;
  }
}

function at(array, row) {
  return array.values.subarray(3 * row, 3 * row + 3);
}
