// SPDX-License-Identifier: Apache-2.0
// The plane of the palm: a grid that fades out, so that depth can be judged.

import * as THREE from "three";

const EVERY = 5; // lines, one of which is stronger

export class Ground {
  /** `cell` is the distance of the lines in m, `count` how many there are on each side. */
  constructor(cell, count) {
    this.points = lattice(count);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(this.points.flatMap(([x, y]) => [x * cell, y * cell, 0]), 3));
    this.colors = new THREE.Float32BufferAttribute(new Float32Array(4 * this.points.length), 4);
    geometry.setAttribute("color", this.colors);
    // Lines rather than a shader on a plane: where there is no graphics card, that is twice as fast.
    this.group = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false }));
    this.count = count;
  }

  paint(theme) {
    const color = new THREE.Color(theme.get("line"));
    this.points.forEach(([x, y, strong], i) => {
      const far = Math.min(1, Math.hypot(x, y) / this.count);
      this.colors.setXYZW(i, color.r, color.g, color.b, (strong ? 0.95 : 0.45) * (1 - far) ** 1.3);
    });
    this.colors.needsUpdate = true;
  }
}

/** Return the ends of all short pieces of the grid: x, y in cells, and whether the line is strong. */
function lattice(count) {
  const points = [];
  for (let i = -count; i <= count; i++) {
    for (let j = -count; j < count; j++) {
      const strong = i % EVERY === 0;
      points.push([i, j, strong], [i, j + 1, strong], [j, i, strong], [j + 1, i, strong]);
    }
  }
  return points;
}
