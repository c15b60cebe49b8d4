// SPDX-License-Identifier: Apache-2.0
// One plot: lines over time, linked with the clock and with the zoom of all others.

import uPlot from "uplot";
import { column, rowAt } from "../data.js";
import { el } from "../dom.js";

const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';
const CLICK = 4; // px that a click may wander
const TELLING = 120; // ms between new values in the legend while it plays; faster nobody reads
const SYNC = uPlot.sync("time");

/**
 * A plot.
 *
 * `spec`: `title`, `unit`, `height`, `lines` (each `label`, `color()`, `data` and optionally `dash`, `width`,
 * `group`, `value`, `points`), `log`, `range` (limits of y), `marks` (whether events are drawn with their signs),
 * `keys` (kind and title of the signs in the legend).
 */
export class Chart {
  constructor(spec, context) {
    this.spec = spec;
    this.context = context;
    this._told = -Infinity;
    this.element = el("figure", { class: "chart" });
    this.body = el("div", { class: "chart-body" });
    this.element.append(this._head(), this.body);
    this.plot = new uPlot(this._options(), [context.time, ...spec.lines.map((line) => line.data)], this.body);
    this.playhead = el("div", { class: "playhead" });
    this.plot.over.append(this.playhead);
    this._listenToMouse();
    new ResizeObserver(() => this._fit()).observe(this.body);
    context.theme.listen(() => this._repaint());
    context.zoom.listen(() => this._zoomed());
    context.player.listen((player) => this._moved(player));
  }

  _head() {
    const { spec } = this;
    this.items = legendItems(spec.lines).map((item) => new LegendItem(item, this));
    this.legend = el("span", { class: "legend" }, ...this.items.map((item) => item.element));
    this._explain(spec.keys);
    return el(
      "figcaption",
      {},
      el("span", { class: "chart-title" }, spec.title, el("small", {}, spec.unit ? ` ${spec.unit}` : "")),
      this.legend,
    );
  }

  /** Explain the signs of the events that there are. */
  _explain(keys = []) {
    const kinds = keys.map(([kind]) => kind).join();
    if (this.kinds === kinds) return;
    this.kinds = kinds;
    for (const key of this.keys ?? []) key.remove();
    this.keys = keys.map(([kind, title]) => el("span", { class: "event-key", "data-kind": kind }, el("i", { class: `sign ${kind}` }), title));
    this.legend.append(...this.keys);
    this._paintKeys();
  }

  _paintKeys() {
    for (const key of this.keys) key.style.setProperty("--event", this.context.theme.event(key.dataset.kind));
  }

  _options() {
    const { spec, context } = this;
    const { theme } = context;
    const axis = (extra) => ({
      stroke: () => theme.get("faint"),
      font: FONT,
      grid: { stroke: () => theme.get("grid"), width: 1 },
      ticks: { show: false },
      ...extra,
    });
    const y = spec.log
      ? { values: powers, filter: decades, grid: { stroke: () => theme.get("grid"), width: 1, filter: decades } }
      : { values: plain };
    const axes = [axis({ size: 26, gap: 4 }), axis({ scale: "y", size: 50, gap: 5, ...y })];
    return {
      width: 400,
      height: spec.height ?? 150,
      padding: [8, 14, 0, 0],
      legend: { show: false },
      scales: {
        x: { time: false, range: () => [context.zoom.min, context.zoom.max] },
        y: { ...(spec.log ? { distr: 3, log: 10, range: wholeDecades } : {}), ...(spec.range ? { range: (...limits) => spec.range(...limits) } : {}) },
      },
      axes,
      series: [{}, ...spec.lines.map((line) => series(line))],
      cursor: {
        sync: { key: SYNC.key, setSeries: false },
        drag: { x: true, y: false, setScale: false },
        y: false,
        points: { size: 6 },
        bind: { dblclick: () => () => context.zoom.reset() },
      },
      hooks: {
        drawClear: [(plot) => drawEvents(plot, spec, context)],
        setSelect: [(plot) => this._selected(plot)],
      },
    };
  }

  _selected(plot) {
    const { left, width } = plot.select;
    if (width > CLICK) this.context.zoom.set(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
    if (width > 0) plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  }

  _listenToMouse() {
    const { over } = this.plot;
    let pressed = null;
    over.addEventListener("mousedown", (event) => (pressed = event.clientX));
    over.addEventListener("click", (event) => {
      if (pressed === null || Math.abs(event.clientX - pressed) > CLICK) return;
      this.context.player.seek(this._timeAt(event));
    });
    const wheel = (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // without a key the page scrolls
      event.preventDefault();
      this.context.zoom.about(this._timeAt(event), event.deltaY > 0 ? 1.25 : 0.8);
    };
    over.addEventListener("wheel", wheel, { passive: false });
  }

  _timeAt(event) {
    return this.plot.posToVal(event.clientX - this.plot.over.getBoundingClientRect().left, "x");
  }

  _fit() {
    const width = Math.floor(this.body.clientWidth);
    if (width > 0 && width !== this.plot.width) {
      this.plot.setSize({ width, height: this.spec.height ?? 150 });
      this._moved(this.context.player);
    }
  }

  _zoomed() {
    const { min, max } = this.context.zoom;
    this.plot.setScale("x", { min, max });
    if (this.playhead) this._moved(this.context.player);
  }

  _moved(player) {
    const share = this.context.zoom.share(player.time);
    const width = this.plot.bbox.width / (window.devicePixelRatio || 1); // without asking for a new layout
    this.playhead.style.display = share < 0 || share > 1 ? "none" : "";
    this.playhead.style.transform = `translateX(${share * width}px)`;
    const now = performance.now();
    if (player.playing && now - this._told < TELLING) return;
    this._told = now;
    const row = rowAt(this.context.time, player.time);
    for (const item of this.items) item.show(row);
  }

  /** Show other data of the same lines. */
  update(spec) {
    this.spec.range = spec.range;
    this._explain(spec.keys);
    for (const item of this.items) for (const line of item.lines) line.data = spec.lines[line.series - 1].data;
    this.plot.setData([this.context.time, ...spec.lines.map((line) => line.data)]);
  }

  _repaint() {
    for (const item of this.items) item.repaint();
    this._paintKeys();
    this.plot.redraw(false);
  }
}

function series(line) {
  const points = line.points ? { show: true, size: 2.5, width: 0, fill: () => line.color() } : { show: false };
  return {
    scale: "y",
    stroke: () => line.color(),
    width: line.points ? 0 : (line.width ?? 1.6),
    dash: line.dash,
    paths: line.points ? () => null : undefined,
    points,
    spanGaps: false,
  };
}

/** Lines of one group share an item of the legend. */
function legendItems(lines) {
  const items = new Map();
  lines.forEach((line, index) => {
    const name = line.group ?? line.label;
    if (!items.has(name)) items.set(name, { name, lines: [] });
    items.get(name).lines.push({ ...line, series: index + 1 });
  });
  return [...items.values()];
}

class LegendItem {
  constructor({ name, lines }, chart) {
    this.lines = lines;
    this.chart = chart;
    this.valued = lines.find((line) => line.value) ?? (lines.length === 1 ? lines[0] : null);
    this.swatch = el("i", { class: lines[0].dash ? "dashed" : lines[0].points ? "dots" : "" });
    this.value = el("b", {});
    this.element = el("button", { type: "button", class: "legend-item", title: "show or hide", onclick: () => this._toggle() }, this.swatch, name, this.value);
    this.repaint();
  }

  repaint() {
    this.swatch.style.color = this.lines[0].color();
  }

  /** Show the value at a row, where there is one to show. */
  show(row) {
    if (!this.valued) return;
    const value = this.valued.data[row];
    const text = value === null || value === undefined ? "" : number(value);
    if (text !== this._text) this.value.textContent = this._text = text;
  }

  _toggle() {
    const off = this.element.classList.toggle("off");
    for (const line of this.lines) this.chart.plot.setSeries(line.series, { show: !off });
  }
}

/** Write a number short and without jumping. */
export function number(value) {
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size < 1e-3 || size >= 1e5) return value.toExponential(1);
  if (size < 1) return value.toFixed(3);
  return size < 10 ? value.toFixed(2) : value.toFixed(1);
}

function plain(_, ticks) {
  return ticks.map((tick) => (tick === null ? "" : String(+tick.toPrecision(6))));
}

const RAISED = { "-": "\u207b", 0: "\u2070", 1: "\u00b9", 2: "\u00b2", 3: "\u00b3", 4: "\u2074", 5: "\u2075", 6: "\u2076", 7: "\u2077", 8: "\u2078", 9: "\u2079" };

function powers(_, ticks) {
  return ticks.map((tick) => {
    if (!tick) return "";
    const power = Math.round(Math.log10(tick));
    if (power >= -2 && power <= 3) return String(+tick.toPrecision(3));
    return `10${[...String(power)].map((sign) => RAISED[sign]).join("")}`;
  });
}

const DEPTH = 1e-6; // what is so much smaller than the largest value is not worth an axis

function wholeDecades(_, min, max) {
  if (!(max > 0)) return [0.1, 1];
  const least = Math.max(min, DEPTH * max);
  const low = Math.floor(Math.log10(least) + 1e-9);
  return [10 ** low, 10 ** Math.max(low + 1, Math.ceil(Math.log10(max) - 1e-9))];
}

/** Keep whole decades only, and of many every second. */
function decades(plot, ticks) {
  const whole = (tick) => Math.abs(Math.log10(tick) - Math.round(Math.log10(tick))) < 1e-6;
  const count = ticks.filter(whole).length;
  const every = count > 6 ? 2 : 1;
  return ticks.map((tick) => (whole(tick) && Math.round(Math.log10(tick)) % every === 0 ? tick : null));
}

/** Draw events behind the lines: a thin rule for each, and its sign where the plot asks for it. */
function drawEvents(plot, spec, { events, theme }) {
  const { ctx } = plot;
  const { left, top, width, height } = plot.bbox;
  const dot = window.devicePixelRatio || 1;
  ctx.save();
  ctx.beginPath();
  ctx.rect(left - 6 * dot, top - 8 * dot, width + 12 * dot, height + 8 * dot);
  ctx.clip();
  const taken = []; // places of signs, so that those of one moment stand below each other
  for (const event of events) {
    const x = plot.valToPos(event.time, "x", true);
    if (x < left || x > left + width) continue;
    ctx.strokeStyle = ctx.fillStyle = theme.event(event.kind);
    ctx.globalAlpha = spec.marks ? 0.7 : 0.28;
    ctx.lineWidth = dot;
    ctx.setLineDash(event.kind === "disturbance" || event.kind === "command" ? [3 * dot, 3 * dot] : []);
    ctx.beginPath();
    ctx.moveTo(x, top);
    ctx.lineTo(x, top + height);
    ctx.stroke();
    if (spec.marks) {
      ctx.globalAlpha = 1;
      const beside = taken.filter((other) => Math.abs(other.x - x) < 10 * dot);
      if (beside.some((other) => other.kind === event.kind)) continue;
      sign(ctx, event.kind, x, top + 11 * dot * beside.length, 4.2 * dot);
      taken.push({ x, kind: event.kind });
    }
  }
  ctx.restore();
}

const CORNERS = { slip: 3, detection: 4, reaction: 3, contact_lost: 0, contact_made: 0, disturbance: 5, command: 4, request: 4, refusal: 4, dropped: 3, gap: 5 };

/** Draw the sign of an event: not by colour alone. */
function sign(ctx, kind, x, y, size) {
  ctx.beginPath();
  ctx.setLineDash([]);
  const corners = CORNERS[kind];
  if (corners === 0) ctx.arc(x, y, size * 0.85, 0, 2 * Math.PI);
  const turn = kind === "slip" ? Math.PI / 2 : -Math.PI / 2;
  for (let i = 0; i < corners; i++) {
    const angle = turn + (2 * Math.PI * i) / corners;
    ctx.lineTo(x + size * Math.cos(angle), y + size * Math.sin(angle));
  }
  ctx.closePath();
  if (kind === "contact_made") {
    ctx.lineWidth = size * 0.4;
    ctx.stroke();
  } else ctx.fill();
}

/** Return columns of an array as data of lines. */
export function columnsOf(array, scale = 1) {
  return Array.from({ length: array.width }, (_, index) => column(array, index, scale));
}
