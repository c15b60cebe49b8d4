// SPDX-License-Identifier: Apache-2.0
// How fine the picture is: coarser while it moves on a slow machine, always fine when it stands still.

const SLOW = 50; // ms between pictures above which the next ones are coarser
const QUICK = 24; // ms below which they may be finer again
const SHARES = [1, 0.75, 0.5]; // of the pixels along an edge
const WEIGHT = 0.3; // of the newest interval in the average

export class Sharpness {
  constructor() {
    this._level = SHARES.length - 1; // a slow machine shows its first picture sooner
    this._last = null;
    this._average = QUICK;
  }

  /** Return the share of full sharpness for the next picture. */
  share(moving) {
    return moving ? SHARES[this._level] : 1;
  }

  /** Take note of a picture that was drawn at a time in ms. */
  drawn(now, moving) {
    if (moving && this._last !== null) this._adapt(now - this._last);
    this._last = moving ? now : null;
  }

  _adapt(interval) {
    this._average += WEIGHT * (interval - this._average);
    const step = this._average > SLOW ? 1 : this._average < QUICK ? -1 : 0;
    if (step === 0 || this._level + step < 0 || this._level + step >= SHARES.length) return;
    this._level += step;
    this._average = (SLOW + QUICK) / 2;
  }
}
