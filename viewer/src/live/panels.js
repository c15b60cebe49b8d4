// SPDX-License-Identifier: Apache-2.0
// What stands beside the picture: health of the nodes, assumptions, the last slip, parameters.

import { el } from "../dom.js";
import { LINK_FAULTS } from "./source.js";

const LEVELS = ["good", "warned", "bad", "stale"];
const WORDS = ["ok", "warning", "error", "silent"];
const STEPS = [["onset", "onset"], ["detection", "detected"], ["reaction", "k_f rises"], ["torque", "torque rises"], ["stuck", "sticks again"]];
const BREAKS = { A2: 0, A4: 0, A6: 0, A7: 1e-3 }; // margins at and below which an assumption is broken

const LAW = "Gains change while the hand holds. The law itself cannot: a new law starts without the load that the old one carries, so the object would drop. Start another run with --set manipulation_controller.law.name=...";

/** Make a panel with a title; `update` replaces its rows. */
function panel(title, small, name) {
  const body = el("div", { class: "rows" });
  return { element: el("section", { class: `panel ${name}` }, el("h2", {}, title, el("small", {}, ` ${small}`)), body), body };
}

/** Make the list of nodes with their faults. */
export function nodeList(source, act) {
  const { element, body } = panel("Nodes", "health and rate", "nodes");
  let shown = "";
  const fault = (node, what) => el("button", { type: "button", class: "chip", "aria-label": `${what} ${node}`, onclick: () => act({ do: "fault", node, what }) }, what);
  const row = (node) => {
    const facts = [`${Number(node.rate_hz).toFixed(0)} Hz`, node.late_commands && `${node.late_commands} late`, node.latency_p99_us && `p99 ${(node.latency_p99_us / 1000).toFixed(1)} ms`, node.mode];
    return el(
      "div",
      { class: "node" },
      el("b", { class: `light ${LEVELS[node.level]}`, role: "img", "aria-label": WORDS[node.level] }),
      el("span", {}, node.name.replaceAll("_", " "), el("small", {}, node.level ? node.message : facts.filter(Boolean).join(", "))),
      el("span", { class: "chips" }, ...(node.alone ? ["stop", "continue", "stall"].map((what) => fault(node.name, what)) : [])),
    );
  };
  const update = () => {
    const { nodes } = source.status;
    const key = JSON.stringify(nodes);
    if (key === shown) return; // a button that is replaced cannot be pressed
    shown = key;
    const note = nodes.some((node) => node.alone) ? null : el("p", { class: "hint" }, "The nodes share one process. To stop a single one, start with --processes.");
    body.replaceChildren(...nodes.map(row), ...[note].filter(Boolean));
  };
  return { element, update };
}

/** Make the faults of the skin of each finger, which a real hand refuses, and of the link of this tab. */
export function breaks(source, act) {
  const { element, body } = panel("Break", "skin and link", "breaks");
  const choice = (name, words, onchange) => {
    const select = el("select", { "aria-label": `fault of ${name}`, onchange: () => onchange(select) }, ...words.map((word) => el("option", { value: word }, word)));
    body.append(el("div", { class: "row" }, el("span", {}, name), select));
    return select;
  };
  let inForce = [];
  let choices = 0; // an answer to an older one must not undo a newer one
  const show = () => skin.forEach((each, i) => (each.value = inForce[i] ?? "none"));
  const asked = async () => {
    const [value, mine] = [skin.map((each) => each.value), ++choices];
    if ((await act({ do: "set", node: "tactile_sensor", name: "faults", value })).ok) inForce = value;
    if (mine === choices) show();
  };
  const skin = source.run.fingers.map(({ name }) => choice(name.replaceAll("_", " "), source.run.faults, asked));
  choice("link of this tab", LINK_FAULTS, (select) => (source.fault = select.value));
  const load = async () => {
    const mine = choices;
    const { ok, text } = await source.ask({ do: "parameters", node: "tactile_sensor" });
    if (!ok || mine !== choices) return;
    inForce = JSON.parse(text).find((one) => one.name === "faults").value;
    show();
  };
  return { element, update: () => {}, load };
}

/** Make the list of assumptions with their margins now. */
export function assumptions(source) {
  const { element, body } = panel("Assumptions", "margins now", "margins");
  const update = () => {
    const rows = Object.entries(source.status.margins).map(([key, value]) => {
      const [name, what] = key.split(" ");
      const broken = name in BREAKS && Number(value) <= BREAKS[name];
      const number = Number.isFinite(Number(value)) ? Number(value).toPrecision(3) : "unknown";
      return el("div", { class: "margin" }, el("b", {}, name), el("span", {}, what.replaceAll("_", " ")), el("span", { class: broken ? "share broken" : "share" }, number));
    });
    body.replaceChildren(...rows);
  };
  return { element, update };
}

/** Make the course of the last slip, in ms from its start. */
export function response(source) {
  const { element, body } = panel("Last slip", "ms from its start", "response");
  const update = () => {
    const { at, finger, ...later } = source.status.response;
    const steps = { onset: 0, ...later };
    if (at === undefined) {
      body.replaceChildren(el("p", { class: "hint" }, "Nothing has slipped yet. Pull at the object, or wet it."));
      return;
    }
    const longest = Math.max(1, ...Object.values(steps));
    const rows = STEPS.map(([key, text]) => {
      const known = key in steps;
      return el("div", { class: "step" }, el("span", {}, text), el("i", { class: key, style: { width: known ? `${(100 * steps[key]) / longest}%` : "0" } }), el("b", {}, known ? `${steps[key].toFixed(0)}` : "\u2013"));
    });
    body.replaceChildren(el("p", { class: "hint" }, `${finger.replaceAll("_", " ")} at ${at.toFixed(3)} s`), ...rows);
  };
  return { element, update };
}

/** Make the forms of the live parameters of all nodes, each loaded when it is opened. */
export function parameters(source, act) {
  const { element, body } = panel("Parameters", "live ones, as declared", "parameters");
  for (const node of source.run.nodes) {
    const rows = el("div", { class: "rows" });
    const opened = async (event) => {
      if (!event.target.open) return;
      const { ok, text } = await act({ do: "parameters", node });
      if (ok) rows.replaceChildren(...JSON.parse(text).map((one) => field(node, one, act)));
    };
    const why = node === "manipulation_controller" ? el("p", { class: "hint" }, LAW) : null;
    body.append(el("details", { ontoggle: opened }, el("summary", {}, node.replaceAll("_", " ")), ...[why].filter(Boolean), rows));
  }
  return { element, update: () => {} };
}

function field(node, { name, value, meaning, unit, choices }, act) {
  const change = async () => {
    const given = Array.isArray(value) ? input.value.split(",").filter(Boolean).map((word) => (isNaN(word) ? word.trim() : Number(word))) : typeof value === "boolean" ? input.checked : typeof value === "number" ? Number(input.value) : input.value;
    const { ok } = await act({ do: "set", node, name, value: given });
    if (ok) value = given;
    else put();
  };
  const id = `${node}-${name}`;
  const kind = typeof value === "boolean" ? "checkbox" : typeof value === "number" ? "number" : "text";
  const input = choices.length
    ? el("select", { id, onchange: change }, ...choices.map((choice) => el("option", { value: choice }, choice)))
    : el("input", { id, type: kind, step: "any", onchange: change });
  const put = () => (kind === "checkbox" ? (input.checked = value) : (input.value = String(value)));
  put();
  return el("div", { class: "field" }, el("label", { for: id, title: meaning }, name, el("small", {}, meaning)), input, el("small", {}, unit));
}
