// SPDX-License-Identifier: Apache-2.0
// What steers the hand and changes the object.

import { rowOf } from "../data.js";
import { el } from "../dom.js";

const PULLS = [["down", [0, 0, -1]], ["up", [0, 0, 1]], ["left", [-1, 0, 0]], ["right", [1, 0, 0]]];

const SAVED = [["the last 10 s", 10], ["the last 60 s", 60], ["all of it", 0]];

/** Make the panel that steers. */
export function controls(page) {
  const { act, source } = page;
  const button = (text, onclick, extra = {}) => el("button", { type: "button", class: "chip", onclick, ...extra }, text);
  const value = {};
  const slider = (name, label, unit, { min = 0, max, step, send }) => {
    const out = el("output", {});
    const input = el("input", {
      type: "range", id: `set-${name}`, min, max, step, "aria-label": `${label}, ${unit}`,
      oninput: () => (out.textContent = `${input.value} ${unit}`),
      onchange: () => send(Number(input.value)),
    });
    value[name] = (given) => {
      if (document.activeElement === input || !Number.isFinite(Number(given))) return;
      input.value = given;
      out.textContent = `${Number(given).toPrecision(3)} ${unit}`;
    };
    return el("div", { class: "row" }, el("label", { for: input.id }, label), input, out);
  };
  const set = (node, name) => (given) => act({ do: "set", node, name, value: given });
  const tilts = ["x", "y"].map((axis) => slider(`tilt-${axis}`, `tilt ${axis}`, "\u00b0", { min: -90, max: 90, step: 1, send: () => turn() }));
  const turn = () => set("plant", "palm_turn")([...["x", "y"].map((axis) => (Number(element.querySelector(`#set-tilt-${axis}`).value) * Math.PI) / 180), 0]);
  const request = (given) => {
    if (mode.value === "auto") page.say("The regulator chooses the grasp force itself; let user or shared choose it.");
    return act({ do: "force", value: given });
  };
  const mode = el("select", { "aria-label": "who chooses the grasp force", onchange: () => set("slip_regulator", "mode")(mode.value) }, ...["user", "shared", "auto"].map((text) => el("option", { value: text }, text)));
  const goals = [["translate", "move"], ["rotate", "turn"], [null, "off"]].map(([kind, text]) =>
    button(text, () => {
      page.handles?.show(kind);
      goals.forEach((chip) => chip.setAttribute("aria-pressed", String(chip.textContent === text)));
    }, { "aria-pressed": String(kind === null), "data-goal": text }),
  );
  const newtons = el("input", { type: "number", min: 0, max: source.run.push, value: 3, step: 0.5, "aria-label": "force of a pull, N" });
  const pulls = PULLS.map(([text, direction]) => button(text, () => page.pull?.(direction, Number(newtons.value), 1), { "aria-label": `pull ${text} for a second` }));
  const last = el("select", { "aria-label": "what to save" }, ...SAVED.map(([text, seconds]) => el("option", { value: seconds }, text)));
  const save = button("save", saving(page, last), { "aria-label": "save the recording and write its report" });
  const report = el("a", { class: "chip", href: `report${window.location.search}`, target: "_blank", rel: "noreferrer", hidden: true }, "report");
  const element = el(
    "section",
    { class: "panel steer" },
    el("h2", {}, "Steer ", el("small", {}, "drag the object to pull at it")),
    slider("force", "grasp force", "N", { max: 60, step: 0.5, send: request }),
    el("div", { class: "row" }, el("span", {}, "chosen by"), mode, el("span", { class: "chips" }, button("release", () => act({ do: "release" })), button("grasp", () => act({ do: "grasp" })))),
    el("div", { class: "row" }, el("span", {}, "goal handles"), el("span", { class: "chips" }, ...goals)),
    slider("friction", "friction", "", { max: 1.5, step: 0.01, send: set("plant", "object.friction") }),
    slider("mass", "mass", "kg", { max: 1, step: 0.01, send: (given) => set("plant", "object.mass")(Math.max(given, 0.001)) }),
    ...tilts,
    el("div", { class: "row" }, el("span", {}, "pull for 1 s"), newtons, el("span", { class: "chips" }, ...pulls)),
    el("div", { class: "row" }, el("span", {}, "keep"), last, el("span", { class: "chips" }, save, button("mark", () => act({ do: "mark", text: "a user's mark" })), report)),
  );
  save.hidden = last.hidden = !source.run.saves;
  const update = () => {
    report.hidden = !source.status.report;
    const { columns, time } = source.run;
    if (!time.length) return;
    for (const each of tilts) each.hidden = !Number.isFinite(rowOf(columns.palm, time.length - 1)[0]);
    value.force(rowOf(columns.grasp_force, time.length - 1)[0].toFixed(1));
  };
  return { element, update, load: () => load(page, value, mode, element) };
}

/** Show the values in force. */
async function load({ source, speed }, value, mode, element) {
  const turned = (given) => ["x", "y"].forEach((axis, i) => value[`tilt-${axis}`]((given[i] * 180) / Math.PI));
  const plant = { palm_turn: turned, "object.friction": value.friction, "object.mass": value.mass, speed: (given) => (speed.value = given) };
  const regulator = { mode: (given) => (mode.value = given), maximum: (given) => (element.querySelector("#set-force").max = given) };
  for (const [node, wanted] of [["plant", plant], ["slip_regulator", regulator]]) {
    const { ok, text } = await source.ask({ do: "parameters", node });
    for (const one of ok ? JSON.parse(text) : []) wanted[one.name]?.(one.value);
  }
}

function saving(page, last) {
  return async () => {
    page.say("saving");
    const { ok, text } = await page.act({ do: "save", last: Number(last.value) });
    if (ok) page.say(text);
  };
}
