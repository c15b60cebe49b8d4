// SPDX-License-Identifier: Apache-2.0
// The 3D view with what lies over it: time, events, what to show, from where to look.

import { el, icon } from "../dom.js";
import { Scene } from "../scene/scene.js";
import { transport } from "./transport.js";

const SHOWN = [
  ["object", "object"],
  ["forces", "forces"],
  ["cones", "friction cones"],
  ["frames", "frames"],
  ["goal", "desired pose"],
  ["trail", "path"],
];
const VIEWS = ["oblique", "front", "side", "top"];
const FRESH = 0.5; // s for which the text of an event stays

/** Make the stage with a bar below; returns its element and the scene, which is null where there is no WebGL. */
export function stage(run, axes, context, bar = transport(run, context)) {
  const canvas = el("canvas", { class: "scene", tabindex: "-1", "aria-label": "3D view of hand and object" });
  const element = el("section", { class: "stage" });
  const viewport = el("div", { class: "viewport" }, canvas, hud(run, context.player));
  element.append(viewport, bar);
  const scene = makeScene(canvas, run, axes, context.theme, viewport);
  if (scene) {
    viewport.append(tools(scene, context.player, element), scaleNote(scene));
    context.player.listen((player) => scene.show(player.time, player.playing));
    new ResizeObserver(() => scene.invalidate()).observe(viewport);
  }
  return { element, viewport, scene };
}

function makeScene(canvas, run, axes, theme, viewport) {
  try {
    return new Scene(canvas, run, axes, theme);
  } catch (error) {
    if (!/WebGL/i.test(String(error))) throw error;
    canvas.remove();
    viewport.append(el("p", { class: "no-webgl" }, "This browser offers no WebGL, so the 3D view is left out; plots and tables are complete."));
    return null;
  }
}

function hud(run, player) {
  const time = el("output", { class: "time" });
  const news = el("div", { class: "news" });
  player.listen(() => {
    time.textContent = `${player.time.toFixed(3)} s`;
    const fresh = run.events.filter((event) => event.time <= player.time + 1e-9 && player.time - event.time < FRESH);
    const key = fresh.map((event) => event.text).join("|");
    if (key === news.dataset.key) return;
    news.dataset.key = key;
    news.replaceChildren(...merged(fresh).map(({ kind, text }) => el("span", { class: `event ${kind}` }, text)));
  });
  return el("div", { class: "hud" }, time, news);
}

const NEWS = { slip: "slip begins", detection: "slip detected", contact_lost: "contact lost", contact_made: "contact made" };

/** Say once what several fingers do at the same time. */
function merged(events) {
  const found = new Map();
  for (const { kind, finger, text } of events) {
    const key = NEWS[kind] ?? text;
    const entry = found.get(key) ?? { kind, fingers: [] };
    if (finger && !entry.fingers.includes(finger)) entry.fingers.push(finger);
    found.set(key, entry);
  }
  const said = [...found].map(([key, { kind, fingers }]) => ({ kind, text: [key, fingers.join(", ").replaceAll("_", " ")].filter(Boolean).join(": ") }));
  return said.slice(-4);
}

function tools(scene, player, element) {
  const shown = SHOWN.filter(([name]) => name !== "object" || scene.solid).map(([name, text]) => {
    const change = (event) => {
      scene.visible[name] = event.target.checked;
      scene.show(player.time);
      event.target.blur();
    };
    return el("label", { class: "chip" }, el("input", { type: "checkbox", checked: true, onchange: change }), text);
  });
  const views = VIEWS.map((name) => el("button", { type: "button", class: "chip", onclick: () => scene.view.look(name) }, name));
  const full = () => (document.fullscreenElement ? document.exitFullscreen() : element.requestFullscreen());
  const whole = el("button", { type: "button", class: "chip icon", title: "full screen", "aria-label": "full screen", onclick: full }, icon("full"));
  return el("div", { class: "tools" }, el("div", { class: "chips" }, ...views, whole), el("details", { class: "layers" }, el("summary", { class: "chip" }, "layers"), ...shown));
}

function scaleNote(scene) {
  const note = el("div", { class: "scale" });
  scene.rescaled = () => {
    const newtons = nice(scene.size / scene.newton);
    note.textContent = `arrows: force on the object, ${newtons} N is ${Math.round(1000 * scene.newton * newtons)} mm long`;
  };
  scene.rescaled();
  return note;
}

function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map((digit) => digit * power).find((candidate) => candidate <= value) ?? power;
}
