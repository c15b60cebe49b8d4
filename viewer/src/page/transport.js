// SPDX-License-Identifier: Apache-2.0
// Play, speed and the bar on which time can be dragged, with a sign for each event.

import { el, icon } from "../dom.js";
import { SPEEDS } from "../player.js";

/** Make the transport bar. */
export function transport(run, { player, theme, zoom }) {
  const play = el("button", { type: "button", class: "play", "aria-label": "play or pause", title: "play or pause (space)", onclick: () => player.toggle() }, icon("play"));
  const first = el("button", { type: "button", class: "quiet", "aria-label": "to the start", title: "to the start (home)", onclick: () => player.seek(player.start) }, icon("start"));
  const speed = el(
    "select",
    { "aria-label": "speed", title: "speed (up, down)", onchange: () => player.setSpeed(Number(speed.value)) || speed.blur() },
    ...SPEEDS.map((value) => el("option", { value: String(value) }, `${value}\u00d7`)),
  );
  const end = el("span", { class: "end" }, `${player.end.toFixed(1)} s`);
  player.listen(() => {
    const shown = player.playing ? "pause" : "play";
    if (play.dataset.shown !== shown) play.replaceChildren(icon(shown));
    play.dataset.shown = shown;
    speed.value = String(player.speed);
  });
  return el("div", { class: "transport" }, first, play, bar(run, player, zoom, theme), end, speed);
}

function bar(run, player, zoom, theme) {
  const share = (time) => (100 * (time - player.start)) / (player.end - player.start || 1);
  const done = el("div", { class: "done" });
  const window_ = el("div", { class: "window" });
  const thumb = el("div", { class: "thumb" });
  const signs = run.events.map((event) => el("i", { class: `mark ${event.kind}`, title: `${event.time.toFixed(3)} s: ${event.text}`, style: { left: `${share(event.time)}%` } }));
  const paint = () => run.events.forEach((event, i) => (signs[i].style.background = theme.event(event.kind)));
  paint();
  theme.listen(paint);
  const track = el("div", { class: "track" }, window_, done, ...signs, thumb);
  const element = el("div", { class: "bar", role: "slider", "aria-label": "time" }, track);
  let width = 0;
  const moved = () => {
    // Transforms only: nothing else on the page has to be laid out again for each picture.
    done.style.transform = `scaleX(${share(player.time) / 100})`;
    thumb.style.transform = `translateX(${(share(player.time) / 100) * width}px)`;
    element.setAttribute("aria-valuenow", player.time.toFixed(3));
  };
  player.listen(moved);
  new ResizeObserver(() => {
    width = track.clientWidth;
    moved();
  }).observe(track);
  zoom.listen(() => Object.assign(window_.style, { left: `${share(zoom.min)}%`, width: `${share(zoom.max) - share(zoom.min)}%`, opacity: zoom.whole ? 0 : 1 }));
  drag(element, track, player);
  return element;
}

function drag(element, track, player) {
  const go = (event) => {
    const { left, width } = track.getBoundingClientRect();
    player.seek(player.start + ((event.clientX - left) / width) * (player.end - player.start));
  };
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    go(event);
  });
  element.addEventListener("pointermove", (event) => element.hasPointerCapture(event.pointerId) && go(event));
}
