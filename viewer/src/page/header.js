// SPDX-License-Identifier: Apache-2.0
// The head of the page: what was run, whether it worked, a few numbers.

import { el, icon } from "../dom.js";

/** Make the head of a report. */
export function header(run, theme) {
  return el("header", { class: "head" }, titleLine(run.name, run.description, [verdict(run.goal_reached)], theme), tiles(run.tiles));
}

/** Make the head of a comparison. */
export function comparisonHeader(runs, colours, theme) {
  const chips = runs.map((run, i) => {
    const chip = el("span", { class: "run-chip" }, el("i", {}), `${i + 1} ${run.name}`, el("small", {}, run.recorded));
    const paint = () => chip.style.setProperty("--run", theme.data(colours[i]));
    paint();
    theme.listen(paint);
    return chip;
  });
  const title = `${runs.length} runs side by side`;
  return el("header", { class: "head" }, titleLine(title, "", [], theme), el("div", { class: "run-chips" }, ...chips));
}

function titleLine(title, description, extra, theme) {
  const dark = el("button", { class: "quiet", type: "button", title: "light or dark (d)", "aria-label": "light or dark", onclick: () => theme.toggle() }, icon("moon"));
  return el(
    "div",
    { class: "title-line" },
    el("h1", {}, title.replaceAll("_", " ")),
    ...extra,
    el("p", {}, description),
    dark,
  );
}

function verdict(reached) {
  if (reached === null) return null;
  return el("span", { class: `verdict ${reached ? "good" : "bad"}` }, reached ? "goal reached" : "goal not reached");
}

function tiles(all) {
  return el(
    "dl",
    { class: "tiles" },
    ...all.map(({ label, value, unit, note }) =>
      el("div", { class: "tile" }, el("dt", {}, label), el("dd", {}, el("b", {}, value), unit ? ` ${unit}` : ""), el("small", {}, note)),
    ),
  );
}
