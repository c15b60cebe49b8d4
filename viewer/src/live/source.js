// SPDX-License-Identifier: Apache-2.0
// A running hand as a run: the same arrays as in a report, filled from a WebSocket.

const RETRY = 1000; // ms
const LATE = 1000; // ms
const PATIENCE = 5000; // ms
const HEAD = 16; // bytes: epoch, rows, width, nothing

/** Faults of the link from a tab to the hand, for `LiveSource.fault`. */
export const LINK_FAULTS = ["none", "silent", "late", "wrong"];

export class LiveSource {
  /** Connect; `changed(what)` is called after news: "run", "rows", "status", "link" or "reply". */
  constructor(changed) {
    this.run = null;
    this.status = { nodes: [], margins: {}, events: [], response: {}, drives: false };
    this.connected = false;
    this.problem = "";
    this.fault = "none";
    this._changed = changed;
    this._waiting = new Map();
    this._number = 0;
    this._connect();
  }

  /** Whether this tab may command. */
  get drives() {
    return this.connected && this.status.drives;
  }

  /** Send a command; resolves to `{ok, text}`. */
  ask(command) {
    if (!this.connected) return Promise.resolve({ ok: false, text: "there is no connection to the cockpit" });
    if (this.fault === "silent") return Promise.resolve({ ok: false, text: "the link of this tab is silent: nothing was sent" });
    const id = ++this._number;
    const sent = this.fault === "wrong" ? wrong(command) : command;
    if (this.fault === "late") setTimeout(() => this._send({ ...sent, id }), LATE);
    else this._send({ ...sent, id });
    return new Promise((resolve) => {
      const late = { reply: id, ok: false, text: "no answer within 5 s; is the node stopped?" };
      const timer = command.do === "save" ? 0 : setTimeout(() => this._received(late), PATIENCE);
      this._waiting.set(id, (answer) => (clearTimeout(timer), resolve(answer)));
    });
  }

  /** Ask for the next picture; call it when the last one has been drawn. */
  ready() {
    this._send({ do: "ready" });
  }

  _send(command) {
    if (this._socket.readyState === WebSocket.OPEN) this._socket.send(JSON.stringify(command));
  }

  _connect() {
    const { host, search } = window.location;
    this._socket = new WebSocket(`ws://${host}/socket${search}`);
    this._socket.binaryType = "arraybuffer";
    this._socket.onopen = () => this._opened();
    this._socket.onmessage = ({ data }) => (typeof data === "string" ? this._received(JSON.parse(data)) : this._rows(data));
    this._socket.onclose = () => this._closed();
  }

  _opened() {
    this.connected = true;
    this._changed("link");
  }

  _closed() {
    this.connected = false;
    for (const resolve of this._waiting.values()) resolve({ ok: false, text: "the connection was lost" });
    this._waiting.clear();
    this._changed("link");
    setTimeout(() => this._again(), RETRY);
  }

  /** Connect again, unless another cockpit, which does not know our token, runs there now. */
  async _again() {
    try {
      const answer = await fetch(window.location.href, { method: "HEAD" });
      if (answer.status === 403) this.problem = "Another cockpit runs now: open the link that it has printed.";
    } catch {
      this.problem = ""; // nobody is there yet
    }
    if (this.problem) this._changed("link");
    else this._connect();
  }

  _received(message) {
    if (message.hello) {
      this._begin(message.hello);
    } else if (message.status) {
      this.status = message.status;
      this._take(message.status.events);
      this._changed("status");
    } else {
      this._waiting.get(message.reply)?.(message);
      this._waiting.delete(message.reply);
    }
  }

  /** Start anew, with arrays of twice the rows that are kept, so that they move only now and then. */
  _begin(hello) {
    const { kept, columns: widths, ...rest } = hello;
    const shape = JSON.stringify([widths, hello.hand, hello.object]);
    if (this.run && shape !== this._shape) window.location.reload(); // another hand
    this._shape = shape;
    this._kept = kept;
    const columns = { time: { values: new Float64Array(2 * kept), width: 1, rows: 0 } };
    for (const [name, width] of Object.entries(widths)) columns[name] = { values: new Float32Array(2 * kept * width), width, rows: 0 };
    this._widths = Object.entries(widths);
    if (this.run) {
      for (const [name, array] of Object.entries(columns)) Object.assign(this.run.columns[name], array);
      this.run.events.length = 0;
    } else this.run = { ...rest, columns, events: [], lastEvent: 0 };
    this.run.time = new Float64Array(0);
    this._changed("run");
  }

  _rows(buffer) {
    const [, count, width] = new Uint32Array(buffer, 0, 3);
    const times = new Float64Array(buffer, HEAD, count);
    const rows = new Float32Array(buffer, HEAD + 8 * count, count * width);
    const { columns } = this.run;
    this._makeRoom(count);
    const first = columns.time.rows;
    columns.time.values.set(times, first);
    columns.time.rows += count;
    let offset = 0;
    for (const [name, size] of this._widths) {
      const array = columns[name];
      for (let row = 0; row < count; row++) array.values.set(rows.subarray(row * width + offset, row * width + offset + size), (first + row) * size);
      array.rows += count;
      offset += size;
    }
    this.run.time = columns.time.values.subarray(0, columns.time.rows);
    this._changed("rows");
  }

  _makeRoom(count) {
    const arrays = Object.values(this.run.columns);
    if (arrays[0].rows + count <= 2 * this._kept) return;
    for (const array of arrays) {
      array.values.copyWithin(0, (array.rows - this._kept + count) * array.width, array.rows * array.width);
      array.rows = this._kept - count;
    }
  }

  _take(events) {
    if (!this.run) return;
    const fresh = events.filter((event) => event.id > this.run.lastEvent);
    this.run.events.push(...fresh);
    this.run.events.splice(0, this.run.events.length - 400);
    if (fresh.length) this.run.lastEvent = fresh.at(-1).id;
  }
}

/** Return a command with numbers that its user did not mean. */
function wrong(command) {
  const spoil = (value) => (typeof value === "number" ? -10 * value : Array.isArray(value) ? value.map(spoil) : value);
  return Object.fromEntries(Object.entries(command).map(([key, value]) => [key, spoil(value)]));
}
