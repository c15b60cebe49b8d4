// SPDX-License-Identifier: Apache-2.0
// Light or dark: as the system says, until somebody presses the button.

const SURFACES = {
  light: { ink: "#1b2430", faint: "#66717f", grid: "#e4e8ee", line: "#c3cad3", panel: "#ffffff",
    bone: "#dfe3e8", joint: "#8b95a3", palm: "#b4bcc7", solid: "#8fa6bf", edge: "#3d5166", goal: "#c2185b", label: "#ffffff" },
  dark: { ink: "#e8edf3", faint: "#93a0b0", grid: "#263140", line: "#3a4757", panel: "#141b25",
    bone: "#b9c2cd", joint: "#5f6b7a", palm: "#566273", solid: "#7f9cbc", edge: "#a9c0d8", goal: "#ff6fa3", label: "#10161f" },
};

const EVENTS = {
  light: { slip: "#d62828", detection: "#e07a00", reaction: "#1f7a4d", contact_lost: "#1b2430", contact_made: "#66717f", disturbance: "#8e44ad", command: "#c2185b", request: "#c2185b", refusal: "#e07a00", dropped: "#d62828", gap: "#66717f" },
  dark: { slip: "#ff5f5f", detection: "#ffab40", reaction: "#4fd18b", contact_lost: "#e8edf3", contact_made: "#93a0b0", disturbance: "#c792ea", command: "#ff6fa3", request: "#ff6fa3", refusal: "#ffab40", dropped: "#ff5f5f", gap: "#93a0b0" },
};

export class Theme {
  constructor() {
    this._system = window.matchMedia("(prefers-color-scheme: dark)");
    this._listeners = [];
    this._apply(this._system.matches);
    this._system.addEventListener("change", () => this._apply(this._system.matches));
  }

  /** Call `listener()` after every change. */
  listen(listener) {
    this._listeners.push(listener);
  }

  toggle() {
    this._apply(!this.dark);
  }

  _apply(dark) {
    this.dark = dark;
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    for (const listener of this._listeners) listener();
  }

  /** Return a colour of the surroundings by its name. */
  get(name) {
    return SURFACES[this.dark ? "dark" : "light"][name];
  }

  event(kind) {
    return EVENTS[this.dark ? "dark" : "light"][kind];
  }

  /** Return a colour of the data; on a dark ground it is lightened, so that it is as easy to see. */
  data(color) {
    return this.dark ? mixed(color, "#ffffff", 0.38) : color;
  }
}

/** Mix two colours such as #0072b2. */
export function mixed(one, other, share) {
  const parts = [1, 3, 5].map((i) => {
    const [a, b] = [one, other].map((color) => parseInt(color.slice(i, i + 2), 16));
    return Math.round(a + share * (b - a)).toString(16).padStart(2, "0");
  });
  return `#${parts.join("")}`;
}
