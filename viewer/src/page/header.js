// SPDX-License-Identifier: Apache-2.0
// The head of the page: what was run, whether it worked, a few numbers.

import { el, icon } from "../dom.js";

/** Make the head of a report. */
export function header(run, theme) {
  return el("header", { class: "head" }, titleLine(run, theme), tiles(run.tiles));
}

/** Make links to the sections of a run between its resets; nothing where there was no reset. */
export function sections(runs, shown) {
  if (runs.length < 2) return null;
  const links = runs.map((run, i) => {
    const [number, end] = [i + 1, run.time[run.time.length - 1]];
    return el("a", { class: `chip ${number === shown ? "shown" : ""}`, href: `#section=${number}` }, `${number}: ${end.toFixed(1)} s, ${run.headline || "until the reset"}`);
  });
  return el("nav", { class: "sections", "aria-label": "sections" }, `${runs.length} sections, each begun by a reset: `, ...links);
}

function titleLine(run, theme) {
  const dark = el("button", { class: "quiet", type: "button", title: "light or dark (d)", "aria-label": "light or dark", onclick: () => theme.toggle() }, icon("moon"));
  return el(
    "div",
    { class: "title-line" },
    el("h1", {}, run.name.replaceAll("_", " ")),
    ...[verdict(run)].filter((part) => part),
    el("p", {}, run.description),
    dark,
  );
}

function verdict({ headline, passed }) {
  if (!headline) return null;
  return el("span", { class: `verdict ${judgement(passed)}` }, headline);
}

function judgement(passed) {
  return typeof passed !== "boolean" ? "" : passed ? "good" : "bad";
}

function tiles(all) {
  return el(
    "dl",
    { class: "tiles" },
    ...all.map(({ label, value, unit, note, passed }) =>
      el("div", { class: `tile ${judgement(passed)}` }, el("dt", {}, label), el("dd", {}, el("b", {}, value), unit ? ` ${unit}` : ""), el("small", {}, note)),
    ),
  );
}
