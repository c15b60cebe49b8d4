// SPDX-License-Identifier: Apache-2.0
// The part of the time that all plots show, the same in each.

export class Zoom {
  constructor(start, end) {
    this.start = start;
    this.end = end > start ? end : start + 1;
    this.min = this.start;
    this.max = this.end;
    this._listeners = [];
  }

  /** Call `listener(zoom)` now and after every change. */
  listen(listener) {
    this._listeners.push(listener);
    listener(this);
  }

  get whole() {
    return this.min === this.start && this.max === this.end;
  }

  /** Show a part; much less than a millisecond is taken for a slip of the hand. */
  set(min, max) {
    if (max - min < 1e-3) return;
    this.min = Math.max(this.start, min);
    this.max = Math.min(this.end, max);
    for (const listener of this._listeners) listener(this);
  }

  /** Move start and end on; `width` of the end is shown, or what was shown before. */
  slide(start, end, width) {
    [this.start, this.end] = [start, Math.max(end, start + 1e-3)];
    if (width) this.set(this.end - width, this.end);
    else this.set(this.min, this.max);
  }

  reset() {
    this.set(this.start, this.end);
  }

  /** Zoom by a factor about a time that keeps its place. */
  about(time, factor) {
    this.set(time - factor * (time - this.min), time + factor * (this.max - time));
  }

  /** Turn the page when a time runs out of it. */
  follow(time) {
    if (time >= this.min && time <= this.max) return;
    const width = this.max - this.min;
    const min = Math.min(Math.max(this.start, time), this.end - width);
    this.set(min, min + width);
  }

  /** Return where a time lies, 0 at the left end and 1 at the right end. */
  share(time) {
    return (time - this.min) / (this.max - this.min);
  }
}
