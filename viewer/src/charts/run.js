// SPDX-License-Identifier: Apache-2.0
// The plots of one run.

import { column } from "../data.js";
import { columnsOf } from "./chart.js";

const DASHES = [undefined, [6, 3], [2, 3], [8, 3, 2, 3]];
const TITLES = {
  slip: "slip",
  detection: "detected",
  reaction: "reaction",
  contact_lost: "contact lost",
  contact_made: "contact made",
  disturbance: "disturbance",
  command: "command",
  request: "request",
  refusal: "refused",
  dropped: "dropped",
  gap: "gap in the recording",
};

/** Return the specifications of all plots of a run. */
export function runCharts(run, theme) {
  const { columns, fingers } = run;
  const color = (i) => () => (i < 0 ? theme.get("faint") : theme.data(fingers[i].color));
  const perFinger = (data, extra = {}) =>
    fingers.map((finger, i) => ({ label: finger.label, color: color(i), data: data[i], ...extra }));
  const normal = fingers.map((_, i) => column(columns.force, 3 * i + 1));
  return [
    {
      title: "Joint rates",
      unit: "rad/s",
      lines: columnsOf(columns.rates).map((data, i) => {
        const { finger, label, place } = run.joints[i];
        return { label, group: fingers[finger]?.label ?? "joints", color: color(finger), data, dash: DASHES[place % 4], width: 1.3 };
      }),
    },
    {
      title: "Pose error",
      unit: "mm and mrad, logarithmic",
      log: true,
      lines: [
        { label: "position", color: () => theme.get("ink"), data: positive(columns.position_error, 1e3), width: 2 },
        { label: "orientation", color: () => theme.event("disturbance"), data: positive(columns.rotation_error, 1e3), dash: [6, 3], width: 1.8 },
      ],
    },
    {
      title: "Normal forces",
      unit: "N; dashed k_f f*_n",
      lines: [
        ...perFinger(normal, { width: 1.8, value: true }),
        ...perFinger(columnsOf(columns.expected), { dash: [5, 4], width: 1.2 }),
      ],
    },
    {
      title: "Force ratio",
      unit: "f_t / f_n; dashed: friction as learned",
      range: (_, min, max) => [0, ceiling(columns.friction, max)],
      lines: [
        ...perFinger(columnsOf(columns.beta), { width: 1.8, value: true }),
        ...perFinger(columnsOf(columns.friction), { dash: [5, 4], width: 1.4 }),
      ],
    },
    {
      title: "Grasp force",
      unit: "k_f, N",
      marks: true,
      range: (_, min, max) => [Math.min(0, min ?? 0), 1.12 * Math.max(max ?? 1, 1e-6)],
      keys: Object.entries(TITLES).filter(([kind]) => run.events.some((event) => event.kind === kind)),
      lines: [{ label: "k_f", color: () => theme.get("ink"), data: column(columns.grasp_force, 0), width: 2 }],
    },
    columns.latency && {
      title: "Latency of each tick",
      unit: "ms, tick to command",
      log: true,
      lines: [{ label: "latency", color: () => theme.data(fingers[0]?.color ?? "#0072b2"), data: positive(columns.latency, 1e3), points: true }],
    },
  ].filter(Boolean);
}

/** Return a column for a logarithmic axis, which has no place for zero. */
function positive(array, scale = 1) {
  return column(array, 0, scale).map((value) => (value > 0 ? value : null));
}

/** Leave room above what was learned, but do not let one spike of the ratio flatten everything. */
function ceiling(friction, max) {
  let learned = 0;
  for (const value of friction.values) if (value > learned) learned = value;
  const top = learned > 0 ? Math.min(max ?? 1, 1.8 * learned) : (max ?? 1);
  return Math.max(1.1 * Math.max(learned, top), 1e-3);
}
