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

/** Make the tables of several runs, a column for each. */
export function tablesSideBySide(runs) {
  const titles = [...new Set(runs.flatMap((run) => run.tables.map((table) => table.title)))];
  return titles.map((title) => {
    const maps = runs.map((run) => new Map(run.tables.find((table) => table.title === title)?.rows ?? []));
    const names = [...new Set(maps.flatMap((map) => [...map.keys()]))];
    const head = el("tr", {}, el("th", {}), ...runs.map((run, i) => el("th", { scope: "col" }, `${i + 1} ${run.label}`)));
    const body = names.map((name) => {
      const values = maps.map((map) => map.get(name) ?? "");
      const same = values.every((value) => value === values[0]);
      return el("tr", { class: same ? "same" : "" }, el("th", { scope: "row" }, name), ...values.map((value) => el("td", {}, value)));
    });
    return el("section", { class: "panel wide" }, el("h2", {}, title), el("table", {}, el("thead", {}, head), el("tbody", {}, ...body)));
  });
}

/** Make the table of the settings in which runs differ. */
export function settingsTable(runs, rows) {
  if (!rows.length) return null;
  const head = el("tr", {}, el("th", {}), ...runs.map((run, i) => el("th", { scope: "col" }, `${i + 1} ${run.label}`)));
  const body = rows.map(([key, ...values]) => el("tr", {}, el("th", { scope: "row" }, key), ...values.map((value) => el("td", {}, value))));
  return el("section", { class: "panel wide settings" }, el("h2", {}, "Settings that differ"), el("table", {}, el("thead", {}, head), el("tbody", {}, ...body)));
}

/** Make the scenario, folded. */
export function scenario(text, name = "") {
  if (!text) return null;
  return el("details", { class: "panel scenario" }, el("summary", {}, el("h2", {}, `Scenario ${name}`)), el("pre", {}, text));
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
export function footer(keys, runs) {
  return el(
    "footer",
    {},
    el("p", {}, ...keys.flatMap(([key, what]) => [el("kbd", {}, key), ` ${what}   `])),
    el("p", {}, "In a plot: click to go there, drag to zoom, double click for the whole time, ctrl and wheel to zoom."),
    ...runs.map((run, i) => el("p", {}, [runs.length > 1 ? `${i + 1} ${run.name}: ` : "", origin(run)].join(""))),
    el("p", {}, "Drawn by three.js and uPlot, both under the MIT licence."),
  );
}

function origin(run) {
  const recorded = run.recorded ? `Recorded ${run.recorded}. ` : "";
  if (run.shown === run.ticks) return `${recorded}All ${run.ticks} ticks are in the page.`;
  return `${recorded}The page shows ${run.shown} of ${run.ticks} ticks, all peaks among them; metrics and events are from all.`;
}
