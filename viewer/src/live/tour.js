// SPDX-License-Identifier: Apache-2.0
// A tour of two minutes: one sentence and one button a step.

import { rowOf } from "../data.js";
import { el } from "../dom.js";

const FRICTION = 0.25; // of wet glass

/** Return the steps: what is to be seen, the text of the button, and what it does. */
function steps(page) {
  const { act, source } = page;
  const moved = () => {
    const { columns, time } = source.run;
    const [p, q] = ["position", "quaternion"].map((name) => [...rowOf(columns[`auxiliary_${name}`], time.length - 1)]);
    const size = page.scene?.size ?? 0.05;
    return act({ do: "pose", position: [p[0], p[1], p[2] + 0.15 * size], quaternion: q });
  };
  const alone = () => source.status.nodes.find((node) => node.alone && node.name === "tactile_sensor");
  return [
    ["The hand holds an object that it knows by touch alone; the cones show how far each force may lean.", "next", () => {}],
    ["Move it: the dashed box is where the object is to go. You can also drag the goal handles.", "move", moved],
    ["Pull at it: drag the object with the mouse. The grasp force k_f rises before it slips.", "pull", () => page.pull?.([0, 0, -1], 4, 1.5)],
    ["Wet it: with less friction the hand must hold it harder. Pull again and watch the last slip.", "wet", () => act({ do: "set", node: "plant", name: "object.friction", value: FRICTION })],
    ["Stop the sense of touch: the hand holds still and says why. (Needs a run with --processes.)", "stop", () => alone() ? act({ do: "fault", node: "tactile_sensor", what: "stop" }) : page.say("the nodes share one process; start with --processes to stop one")],
    ["Let touch continue, and the hand goes on.", "continue", () => alone() && act({ do: "fault", node: "tactile_sensor", what: "continue" })],
    ["Release: the fingers open, and an object without support falls. Reset brings it back.", "release", () => act({ do: "release" })],
  ];
}

/** Make the tour, folded until it is wanted. */
export function tour(page) {
  const all = steps(page);
  const sentence = el("p", { "aria-live": "polite" });
  let at = 0;
  const show = () => {
    sentence.textContent = at < all.length ? `${at + 1} of ${all.length}: ${all[at][0]}` : "That was the tour. Reset starts anew.";
    next.textContent = at < all.length ? all[at][1] : "again";
  };
  const next = el("button", { type: "button", class: "chip", onclick: () => {
    if (at < all.length) all[at][2]();
    at = at < all.length ? at + 1 : 0;
    show();
  } });
  show();
  return el("details", { class: "panel tour" }, el("summary", {}, "A tour of two minutes"), el("div", { class: "row" }, sentence, next));
}
