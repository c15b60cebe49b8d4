// SPDX-License-Identifier: Apache-2.0
// Tables, the scenario and notes.

import { el } from "../dom.js";

/** Make the tables of a run. */
export function tables(all) {
  return all.map(({ title, rows }) =>
    el(
      "section",
      { class: "panel" },
      el("h2", {}, title),
      el("table", {}, el("tbody", {}, ...rows.map(([name, value]) => el("tr", {}, el("th", { scope: "row" }, name), el("td", {}, value))))),
    ),
  );
}

/** Make the scenario, folded. */
export function scenario(text) {
  if (!text) return null;
  return el("details", { class: "panel scenario" }, el("summary", {}, el("h2", {}, "Scenario")), el("pre", {}, text));
}

/** Make the notes that a reader must see. */
export function notes(all) {
  return all.length ? el("ul", { class: "notes" }, ...all.map((note) => el("li", {}, note))) : null;
}

/** Make the list of events; a click goes there. */
export function eventList(events, player) {
  if (!events.length) return null;
  const rows = events.map((event) =>
    el("tr", { class: "link", onclick: () => player.seek(event.time) }, el("th", { scope: "row" }, `${event.time.toFixed(3)} s`), el("td", {}, event.text)),
  );
  return el("section", { class: "panel" }, el("h2", {}, "Events"), el("div", { class: "scroll" }, el("table", {}, el("tbody", {}, ...rows))));
}

/** Make the foot of the page. */
export function footer(keys, run) {
  return el(
    "footer",
    {},
    el("p", {}, ...keys.flatMap(([key, what]) => [el("kbd", {}, key), ` ${what}   `])),
    el("p", {}, "In a plot: click to go there, drag to zoom, double click for the whole time, ctrl and wheel to zoom."),
    el("p", {}, origin(run)),
    el("p", {}, "Drawn by three.js and uPlot, both under the MIT licence."),
  );
}

function origin(run) {
  const recorded = run.recorded ? `Recorded ${run.recorded}. ` : "";
  if (run.shown === run.ticks) return `${recorded}All ${run.ticks} ticks are in the page.`;
  return `${recorded}The page shows ${run.shown} of ${run.ticks} ticks, all peaks among them; metrics and events are from all.`;
}
