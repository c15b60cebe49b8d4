// SPDX-License-Identifier: Apache-2.0
// The one clock of the page: everything that shows a time listens to it.

export const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4];

export class Player {
  /** A clock from `start` to `end`, both in simulated seconds. */
  constructor(start, end) {
    this.start = start;
    this.end = end;
    this.time = start;
    this.playing = false;
    this.speed = 1;
    this._listeners = [];
    this._last = 0;
  }

  /** Call `listener(player)` after every change of time or state. */
  listen(listener) {
    this._listeners.push(listener);
    listener(this);
  }

  /** Go to a time. */
  seek(time) {
    this.time = Math.min(this.end, Math.max(this.start, time));
    this._tell();
  }

  play() {
    if (this.playing) return;
    if (this.time >= this.end) this.time = this.start;
    this.playing = true;
    this._last = performance.now();
    requestAnimationFrame((now) => this._step(now));
    this._tell();
  }

  pause() {
    this.playing = false;
    this._tell();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  setSpeed(speed) {
    this.speed = speed;
    this._tell();
  }

  /** Take the next faster (+1) or slower (-1) speed. */
  shift(direction) {
    const place = SPEEDS.indexOf(this.speed) + direction;
    if (place >= 0 && place < SPEEDS.length) this.setSpeed(SPEEDS[place]);
  }

  _step(now) {
    if (!this.playing) return;
    const passed = Math.max(0, now - this._last) / 1000;
    this._last = now;
    this.time = Math.min(this.end, this.time + this.speed * passed);
    if (this.time >= this.end) this.playing = false;
    else requestAnimationFrame((next) => this._step(next));
    this._tell();
  }

  _tell() {
    for (const listener of this._listeners) listener(this);
  }
}
