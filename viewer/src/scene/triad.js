// SPDX-License-Identifier: Apache-2.0
// The axes of a frame.

import * as THREE from "three";
import { segments } from "./lines.js";

/** Make the axes of a frame; `colors` are those of x, y and z. */
export function triad(length, colors, width = 2.5) {
  const points = [0, 1, 2].flatMap((i) => [0, 0, 0, ...[0, 1, 2].map((j) => (i === j ? length : 0))]);
  const paint = colors.flatMap((name) => {
    const color = new THREE.Color(name);
    return [color.r, color.g, color.b, color.r, color.g, color.b];
  });
  return segments(points, { linewidth: width }, paint);
}
