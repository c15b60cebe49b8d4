// SPDX-License-Identifier: Apache-2.0
// The page of a running hand: the picture and the plots of a report, and what steers the hand.

import * as THREE from "three";
import { Chart } from "../charts/chart.js";
import { runCharts } from "../charts/run.js";
import { rowOf } from "../data.js";
import { el, icon } from "../dom.js";
import { listenToKeys } from "../keyboard.js";
import { stage } from "../page/stage.js";
import { Zoom } from "../zoom.js";
import { controls } from "./controls.js";
import { assumptions, breaks, nodeList, parameters, response } from "./panels.js";
import { LivePlayer } from "./player.js";
import { Handles, Spring } from "./pull.js";
import { LiveSource } from "./source.js";
import { tour } from "./tour.js";

const SHOWN = 10; // s in the plots
const PLOTTING = [120, 8]; // ms between two plots, at least, and so many times what one takes
const TRAIL = 500; // ms between two paths
const KEYS = [["space", "follow or look back"], ["left, right", "look back and on"], ["r", "whole time"], ["d", "light or dark"]];

/** Show a running hand; returns what tests and the console look at. */
export function showLive(content, theme, root) {
  const page = { theme, scene: null, charts: [], player: new LivePlayer() };
  const source = new LiveSource((what) => changed(page, what));
  page.source = source;
  const toast = el("div", { class: "toast", role: "status", "aria-live": "polite" });
  page.say = (text) => say(toast, text);
  page.act = async (command) => {
    const answer = await source.ask(command);
    if (!answer.ok) page.say(answer.text);
    return answer;
  };
  page.state = el("span", { class: "verdict" }, "connecting");
  page.lease = el("button", { type: "button", class: "chip lease", onclick: () => page.act({ do: "drive" }) });
  const dark = el("button", { class: "quiet", type: "button", title: "light or dark (d)", "aria-label": "light or dark", onclick: () => theme.toggle() }, icon("moon"));
  const title = el("div", { class: "title-line" }, el("h1", {}, content.live.replaceAll("_", " ")), page.state, el("p", {}), page.lease, dark);
  page.body = el("div", { class: "live" }, el("p", { class: "panel hint" }, "Waiting for joint_states and robot_description of a hand. A simulated one starts with tactile-hand run --interactive."));
  root.append(el("header", { class: "head" }, title), page.body, toast);
  page.build = () => build(page, content);
  return page;
}

function say(toast, text) {
  toast.textContent = text;
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => (toast.textContent = ""), 5000);
}

function changed(page, what) {
  const { source } = page;
  if (what === "rows") {
    page.fresh ??= requestAnimationFrame(() => picture(page));
    return;
  }
  showState(page);
  refresh(page, what === "run" || page.drove !== source.drives);
  page.drove = source.drives;
  if (what === "status") refusals(page);
  if (what === "run") page.player.playing = true; // the last picture stays until there are rows
}

/** Update the panels; `anew` asks for the values in force, too, which others may have changed. */
function refresh(page, anew) {
  for (const part of page.parts ?? []) {
    part.update();
    if (anew) part.load?.();
  }
}

/** Draw what has come, then ask for more: a tab that does not draw gets nothing. */
function picture(page) {
  page.fresh = null;
  const { source, player } = page;
  const { time } = source.run;
  if (time.length) {
    player.advance(time[0], time[time.length - 1]);
    if (!page.built) page.build();
    if (player.playing && page.charts.length) plots(page);
    page.handles?.follow();
    page.up?.();
  }
  source.ready();
}

function plots(page) {
  const { source, zoom } = page;
  const began = performance.now();
  if (began < (page.plotDue ?? 0)) return;
  const { time } = source.run;
  const specs = runCharts(source.run, page.theme);
  zoom.slide(time[0], time[time.length - 1], SHOWN);
  page.charts.forEach((chart, i) => chart.update(specs[i]));
  if (page.scene && began > (page.trailDue ?? 0)) {
    page.trailDue = began + TRAIL;
    page.scene.trail.renew(source.run.columns.auxiliary_position);
    page.scene.rescale();
  }
  page.plotDue = began + Math.max(PLOTTING[0], PLOTTING[1] * (performance.now() - began));
}

function build(page, content) {
  page.built = true;
  const { source, player, theme } = page;
  const { run } = source;
  page.zoom = new Zoom(player.start, player.end);
  const context = { events: run.events, theme, player, zoom: page.zoom, get time() { return run.time; } };
  const { element, viewport, scene } = stage(run, content.axes, context, bar(page));
  page.scene = scene;
  listenToKeys({ player, zoom: page.zoom, theme, events: run.events, times: [0, 0.1] });
  if (scene) hands(page, viewport);
  const side = el("div", { class: "side" });
  const below = el("div", { class: "below" });
  page.body.replaceChildren(
    tour(page),
    el("main", { class: "linked" }, element, side),
    below,
    el("footer", {}, el("p", {}, ...KEYS.flatMap(([key, text]) => [el("kbd", {}, key), ` ${text}   `])), el("p", {}, "Drawn by three.js and uPlot, both under the MIT licence.")),
  );
  document.documentElement.style.setProperty("--above", `${element.getBoundingClientRect().top + window.scrollY}px`);
  scene?.draw(); // the hand first, then what stands around it
  setTimeout(() => surround(page, context, side, below));
}

/** Add panels and plots. */
function surround(page, context, side, below) {
  const { source } = page;
  page.parts = [controls(page), response(source), nodeList(source, page.act), breaks(source, page.act), assumptions(source), parameters(source, page.act)];
  const [steering, last, ...rest] = page.parts;
  const charts = el("div", { class: "plots" });
  side.append(steering.element, last.element, charts);
  below.append(...rest.map((part) => part.element));
  page.charts = runCharts(source.run, page.theme).map((spec) => new Chart(spec, context));
  charts.append(...page.charts.map((chart) => chart.element));
  refresh(page, true);
}

/** Give the scene a spring for the mouse and handles for the goal. */
function hands(page, viewport) {
  const { scene, source } = page;
  const canvas = scene.renderer.domElement;
  const force = el("output", { class: "force", "aria-label": "force of the pull" });
  viewport.append(force);
  const told = (newtons) => (force.textContent = newtons === null ? "" : `${newtons.toFixed(1)} N`);
  page.handles = new Handles(scene, source, canvas, page.say);
  page.up = upArrow(scene, source);
  if (!source.run.object) return;
  page.spring = new Spring(scene, source, canvas, told);
  page.spring.wanted = () => source.drives && page.player.playing && !page.handles.busy;
  /** Pull at the center along an axis of the palm for some time, without a mouse. */
  page.pull = (direction, newtons, seconds) => {
    if (!scene.solid?.known || page.spring.holds) return;
    const center = scene.solid.group.position.clone();
    page.spring.grab(center);
    page.spring.target.addScaledVector(new THREE.Vector3(...direction), newtons / page.spring.stiffness);
    setTimeout(() => page.spring.release(), 1000 * seconds);
  };
}

/** Add an arrow that points up in the world, while an IMU tells where that is; returns its update. */
function upArrow(scene, source) {
  const length = 0.8 * scene.size;
  const arrow = new THREE.ArrowHelper(new THREE.Vector3(0, 0, 1), new THREE.Vector3(), length, 0x8a8f98, 0.15 * length, 0.08 * length);
  scene.scene.add(arrow);
  const palm = new THREE.Quaternion();
  const update = () => {
    const rotation = rowOf(source.run.columns.palm, scene.row);
    arrow.visible = Number.isFinite(rotation[0]);
    if (arrow.visible) arrow.setDirection(new THREE.Vector3(0, 0, 1).applyQuaternion(palm.set(...rotation).conjugate()));
  };
  return Object.assign(update, { arrow });
}

function bar(page) {
  const { player } = page;
  const button = (text, label, onclick) => el("button", { type: "button", class: "chip", "aria-label": label, onclick }, text);
  const follow = button("live", "follow the hand", () => player.play());
  const back = el("input", { type: "range", min: 0, max: 1000, value: 1000, "aria-label": "look back", oninput: () => player.seek(player.start + (back.value / 1000) * (player.end - player.start)) });
  player.listen(() => {
    follow.classList.toggle("shown", player.playing);
    follow.setAttribute("aria-pressed", String(player.playing));
    if (player.playing) back.value = 1000;
  });
  const act = (what, text, label) => button(text, label, () => page.act({ do: what }));
  const speed = el(
    "select",
    { "aria-label": "speed", title: "times real time, at most", onchange: () => page.act({ do: "set", node: "plant", name: "speed", value: Number(speed.value) }) },
    ...SPEEDS.map(([value, text]) => el("option", { value, selected: value === 1 }, text)),
  );
  page.speed = speed;
  const toggle = button("pause", "pause or run the simulation", () => page.act({ do: toggle.textContent }));
  page.toggle = toggle;
  return el("div", { class: "transport" }, toggle, act("step", "step", "one tick on, while it is paused"), act("reset", "reset", "back to the start"), speed, back, follow);
}

const SPEEDS = [[0.1, "0.1\u00d7"], [0.25, "0.25\u00d7"], [0.5, "0.5\u00d7"], [1, "1\u00d7"], [2, "2\u00d7"], [0, "max"]];
const MODES = { running: "good", holding: "bad", paused: "", finished: "" };

function showState(page) {
  const { source } = page;
  const plant = source.status.nodes.find((node) => node.name === "plant");
  const silent = Boolean(plant?.silent);
  const word = source.problem || (!source.connected ? "no connection, trying again" : silent ? "the hand is silent" : plant ? plant.mode : "no hand");
  page.state.textContent = word;
  page.state.className = `verdict ${!source.connected || silent ? "bad" : (MODES[word] ?? "")}`;
  if (page.toggle) page.toggle.textContent = plant?.mode === "paused" ? "run" : "pause";
  page.lease.textContent = source.drives ? "in control" : "take over";
  page.lease.disabled = source.drives || !source.connected;
  document.documentElement.dataset.drives = source.drives;
}

/** Say why a command was refused; the handles are back where the hand goes by themselves. */
function refusals(page) {
  const events = page.source.run?.events ?? [];
  const last = events.findLast((event) => event.kind === "refusal" && event.id > (page.seen ?? Infinity));
  page.seen = events.at(-1)?.id ?? 0;
  if (last) page.say(last.text);
}
