// SPDX-License-Identifier: Apache-2.0
// The plots of several runs laid over each other.

import { column, rowAt } from "../data.js";

/** Return all times at which any of the runs has a tick. */
export function commonTimes(runs) {
  const all = new Set();
  for (const run of runs) for (const time of run.time) all.add(Math.round(time * 1e6) / 1e6);
  return Float64Array.from([...all].sort((a, b) => a - b));
}

/** Return the specifications of all plots. */
export function comparisonCharts(document, times, theme) {
  const { runs, palette } = document;
  const places = runs.map((run) => placement(run, times));
  const over = (pick, extra = {}) =>
    runs.map((run, i) => ({
      label: `${i + 1} ${run.label}`,
      color: () => theme.data(palette.runs[i]),
      data: spread(pick(run), places[i]),
      width: 1.8,
      ...extra,
    }));
  const log = (values, scale = 1) => values.map((value) => (value > 0 ? scale * value : null));
  return [
    { title: "Position error", unit: "mm, logarithmic", log: true, lines: over((run) => log(column(run.columns.position_error, 0), 1e3)) },
    { title: "Orientation error", unit: "rad, logarithmic", log: true, lines: over((run) => log(column(run.columns.rotation_error, 0))) },
    { title: "Grasp force", unit: "k_f, N", lines: over((run) => column(run.columns.grasp_force, 0)) },
    { title: "Sum of normal forces", unit: "N", lines: over((run) => overFingers(run.columns.force, 3, 1, (a, b) => a + b)) },
    { title: "Largest force ratio", unit: "f_t / f_n of any finger", lines: over((run) => overFingers(run.columns.beta, 1, 0, Math.max)) },
    { title: "Largest tangential force", unit: "N of any finger", lines: over((run) => tangential(run.columns.force)) },
    { title: "Friction as learned", unit: "minimum over the fingers", lines: over((run) => overFingers(run.columns.friction, 1, 0, Math.min)) },
    { title: "Largest joint rate", unit: "rad/s", lines: over((run) => overFingers(run.columns.rates, 1, 0, (a, b) => Math.max(Math.abs(a), Math.abs(b)))) },
    { title: "Latency of each tick", unit: "ms, logarithmic", log: true, lines: over((run) => log(column(run.columns.latency, 0), 1e3), { points: true }) },
  ];
}

/** Return the row of a run for each common time, -1 outside of it and where its recording has a gap. */
function placement({ time: own, gaps }, times) {
  const unknown = (time) => time < own[0] - 1e-6 || time > own[own.length - 1] + 1e-6 || gaps.some(([from, to]) => time > from + 1e-6 && time < to - 1e-6);
  return Array.from(times, (time) => (unknown(time) ? -1 : rowAt(own, time + 1e-6)));
}

/** Hold each value until the next tick of its run. */
function spread(values, place) {
  return place.map((row) => (row < 0 ? null : values[row]));
}

/** Return the largest tangential force of any finger, row by row. */
function tangential(force) {
  const sizes = { rows: force.rows, width: force.width / 3, values: new Float32Array(force.values.length / 3) };
  sizes.values.forEach((_, i) => (sizes.values[i] = Math.hypot(force.values[3 * i], force.values[3 * i + 2])));
  return overFingers(sizes, 1, 0, Math.max);
}

/** Combine every `stride`-th column from `first` on, row by row; null where one is unknown. */
function overFingers(array, stride, first, combine) {
  const out = new Array(array.rows);
  for (let row = 0; row < array.rows; row++) {
    let result = null;
    for (let i = first; i < array.width; i += stride) {
      const value = array.values[row * array.width + i];
      if (Number.isFinite(value)) result = result === null ? Math.abs(value) : combine(result, value);
    }
    out[row] = result;
  }
  return out;
}
