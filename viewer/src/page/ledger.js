// SPDX-License-Identifier: Apache-2.0
// The assumptions as a timeline: when each held and when it did not.

import { el } from "../dom.js";

/** Make the ledger; times are linked with the plots. */
export function ledger(lines, { player, zoom }) {
  if (!lines.length) return null;
  const rows = lines.map((line) => row(line, player, zoom));
  return el("section", { class: "panel ledger" }, el("h2", {}, "Assumptions ", el("small", {}, "worst value, limit, and when each held")), ...rows);
}

function row(line, player, zoom) {
  const state = line.held === null ? "unjudged" : line.broken.length ? "broken" : "held";
  const gaps = line.broken.map(([from, to]) => ({ from, to, bar: el("i", { class: "gap", title: `not from ${from.toFixed(3)} s to ${to.toFixed(3)} s` }) }));
  const head = el("div", { class: "playhead" });
  let width = 0;
  const track = el("div", { class: `lane ${state}`, onclick: (event) => {
    const { left, width } = track.getBoundingClientRect();
    player.seek(zoom.min + ((event.clientX - left) / width) * (zoom.max - zoom.min));
  } }, ...gaps.map((gap) => gap.bar), head);
  const placed = () => {
    for (const { from, to, bar } of gaps) {
      const [left, right] = [zoom.share(from), zoom.share(to)].map((share) => 100 * Math.min(1, Math.max(0, share)));
      Object.assign(bar.style, { left: `${left}%`, width: `max(2px, ${right - left}%)`, display: zoom.share(to) < 0 || zoom.share(from) > 1 ? "none" : "" });
    }
    moved();
  };
  const moved = () => {
    const share = zoom.share(player.time);
    head.style.transform = `translateX(${share * width}px)`;
    head.style.display = share < 0 || share > 1 ? "none" : "";
  };
  new ResizeObserver(() => {
    width = track.clientWidth;
    moved();
  }).observe(track);
  zoom.listen(placed);
  player.listen(moved);
  const share = line.held === null ? "not judged" : line.broken.length ? `${(100 * line.held).toFixed(1)} %` : "held";
  return el(
    "div",
    { class: "ledger-row", title: `${line.margin}: worst ${line.worst}, limit ${line.limit}` },
    el("b", {}, line.name),
    el("span", { class: "meaning" }, line.meaning, el("small", {}, `${line.margin}: ${line.worst} (${line.limit})`)),
    track,
    el("span", { class: `share ${state}` }, share),
  );
}
