// SPDX-License-Identifier: Apache-2.0
// Lines that are wider than one pixel, so that a projector shows them.

import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";

/** Make segments from a flat list of coordinates, two points each. */
export function segments(points, options, colors = null) {
  const geometry = new LineSegmentsGeometry();
  geometry.setPositions(points);
  if (colors) geometry.setColors(colors);
  const line = new LineSegments2(geometry, new LineMaterial({ vertexColors: Boolean(colors), ...options }));
  if (options.dashed) line.computeLineDistances();
  line.frustumCulled = false;
  return line;
}
