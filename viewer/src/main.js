// SPDX-License-Identifier: Apache-2.0
// Puts the page together from the document that it carries.

import "uplot/dist/uPlot.min.css";
import "./style.css";
import { Chart } from "./charts/chart.js";
import { runCharts } from "./charts/run.js";
import { readDocument } from "./data.js";
import { el } from "./dom.js";
import { showLive } from "./live/cockpit.js";
import { KEYS, listenToKeys } from "./keyboard.js";
import { header, sections } from "./page/header.js";
import { ledger } from "./page/ledger.js";
import { stage } from "./page/stage.js";
import { eventList, footer, notes, scenario, tables } from "./page/tables.js";
import { transport } from "./page/transport.js";
import { Player } from "./player.js";
import { Theme } from "./theme.js";
import { Zoom } from "./zoom.js";

const content = readDocument();
const theme = new Theme();
const root = document.getElementById("report");

/** Make what all parts of the page share. */
function makeContext(time, events) {
  const [start, end] = [time[0], time[time.length - 1]];
  const context = { time, events, theme, player: new Player(start, end), zoom: new Zoom(start, end) };
  context.player.listen((player) => player.playing && context.zoom.follow(player.time));
  listenToKeys({ ...context, times: time });
  return context;
}

function showRun(run, navigation) {
  const context = makeContext(run.time, run.events);
  const { element, scene } = stage(run, content.axes, context);
  const plots = el("div", { class: "plots" });
  const below = [...tables(run.tables), eventList(run.events, context.player)].filter((part) => part);
  root.append(
    header(run, theme),
    ...[navigation, notes(run.notes)].filter((part) => part),
    el("main", { class: "linked" }, element, el("div", { class: "side" }, plots, ledger(run.assumptions, context))),
    el("div", { class: "below" }, ...below),
    ...[scenario(run.scenario)].filter((part) => part),
    footer(KEYS, run),
  );
  // As high as the window leaves below the head, so that all of it is seen at first.
  root.style.setProperty("--above", `${element.getBoundingClientRect().top + window.scrollY}px`);
  const charts = runCharts(run, theme).map((spec) => new Chart(spec, context));
  plots.append(...charts.map((chart) => chart.element));
  return { ...context, scene, charts };
}

/** Show the section that the address names, the last one by default; each reset begins one. */
function showSection() {
  const last = content.runs.length;
  const wanted = Number(/^#section=(\d+)$/.exec(window.location.hash)?.[1] ?? last);
  const shown = Math.min(Math.max(wanted, 1), last);
  window.addEventListener("hashchange", () => window.location.reload());
  return { ...showRun(content.runs[shown - 1], sections(content.runs, shown)), section: shown };
}

/** For tests and for the console. */
window.report = content.live ? showLive(content, theme, root) : showSection();
