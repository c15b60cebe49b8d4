// SPDX-License-Identifier: Apache-2.0
// The clock of a running hand: it follows the newest tick until somebody looks back.

import { Player } from "../player.js";

export class LivePlayer extends Player {
  constructor() {
    super(0, 0);
    this.playing = true;
  }

  /** Take the time of the oldest and of the newest tick. */
  advance(start, end) {
    [this.start, this.end] = [start, end];
    if (this.playing) super.seek(end);
    else if (this.time < start) super.seek(start);
  }

  seek(time) {
    this.playing = false;
    super.seek(time);
  }

  play() {
    this.playing = true;
    super.seek(this.end);
  }
}
