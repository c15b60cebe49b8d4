// SPDX-License-Identifier: Apache-2.0
// The path of the grasp: all of it faint, what is behind us strong.

import * as THREE from "three";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
import { segments } from "./lines.js";

const PIECES = 240;
const NOWHERE = [0, 0, 0, 0, 0, 0];

export class Trail {
  constructor(array) {
    this.whole = segments(NOWHERE, { linewidth: 1.4, transparent: true, opacity: 0.3 });
    this.done = segments(NOWHERE, { linewidth: 3 });
    this.group = new THREE.Group().add(this.whole, this.done);
    this.renew(array);
  }

  /** Take the path of the rows that there are now; the materials, with their shaders, stay. */
  renew(array) {
    const rows = [];
    const step = Math.max(1, Math.floor(array.rows / PIECES));
    for (let row = 0; row < array.rows; row += step) if (Number.isFinite(array.values[3 * row])) rows.push(row);
    const points = rows.slice(1).flatMap((row, i) => [...at(array, rows[i]), ...at(array, row)]);
    this.rows = rows;
    this.whole.visible = points.length > 0;
    if (!points.length) return;
    for (const line of [this.whole, this.done]) {
      line.geometry.dispose();
      line.geometry = new LineSegmentsGeometry().setPositions(points);
    }
  }

  paint(theme) {
    for (const line of [this.whole, this.done]) line.material.color.set(theme.get("goal"));
  }

  show(row) {
    let count = 0;
    while (count + 1 < this.rows.length && this.rows[count + 1] <= row) count++;
    this.done.geometry.instanceCount = count;
    this.done.visible = count > 0;
  }
}

function at(array, row) {
  return array.values.subarray(3 * row, 3 * row + 3);
}
