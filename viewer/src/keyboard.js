// SPDX-License-Identifier: Apache-2.0
// What the keys do; fields that take keys themselves keep them.

export const KEYS = [
  ["space", "play and pause"],
  ["left, right", "0.1 s back and on; with shift one tick"],
  ["up, down", "faster, slower"],
  ["home, end", "first and last tick"],
  ["n, p", "next and previous event"],
  ["r", "whole time in the plots"],
  ["d", "light or dark"],
];

const OWN = new Set(["INPUT", "SELECT", "TEXTAREA", "SUMMARY"]);

/** Listen to the keyboard. */
export function listenToKeys({ player, zoom, theme, events, times }) {
  const beside = (direction) => {
    const all = events.map((event) => event.time).filter((t) => direction * (t - player.time) > 1e-6);
    if (all.length) player.seek(direction > 0 ? Math.min(...all) : Math.max(...all));
  };
  const step = (event, direction) => {
    const tick = times.length > 1 ? (times[times.length - 1] - times[0]) / (times.length - 1) : 0.1;
    player.seek(player.time + direction * (event.shiftKey ? tick : 0.1));
  };
  const actions = {
    " ": () => player.toggle(),
    ArrowLeft: (event) => step(event, -1),
    ArrowRight: (event) => step(event, 1),
    ArrowUp: () => player.shift(1),
    ArrowDown: () => player.shift(-1),
    Home: () => player.seek(player.start),
    End: () => player.seek(player.end),
    n: () => beside(1),
    p: () => beside(-1),
    r: () => zoom.reset(),
    d: () => theme.toggle(),
  };
  window.addEventListener("keydown", (event) => {
    const busy = OWN.has(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey;
    const action = actions[event.key];
    if (busy || !action) return;
    event.preventDefault(); // a button that was clicked last would be pressed again by space
    action(event);
  });
}
