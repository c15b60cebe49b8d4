// SPDX-License-Identifier: Apache-2.0
// The embedded document: arrays out of base64, rows by time.

const TYPES = { f4: Float32Array, f8: Float64Array };

/** Read the document that the page carries. */
export function readDocument() {
  const content = JSON.parse(document.getElementById("document").textContent);
  for (const run of content.runs ?? []) {
    for (const name of Object.keys(run.columns)) run.columns[name] = unpack(run.columns[name]);
    run.time = run.columns.time.values;
  }
  return content;
}

function unpack({ type, shape, data }) {
  const text = atob(data);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const width = shape.slice(1).reduce((product, size) => product * size, 1);
  return { values: new TYPES[type](bytes.buffer), width, rows: shape[0] };
}

/** Return one column of an array as numbers for a plot; what is not known becomes null. */
export function column(array, index, scale = 1) {
  const out = new Array(array.rows);
  for (let row = 0; row < array.rows; row++) {
    const value = array.values[row * array.width + index];
    out[row] = Number.isFinite(value) ? scale * value : null;
  }
  return out;
}

/** Return the last row at or before a time, the first one before all. */
export function rowAt(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time + 1e-9) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the row of an array as a view, shape (width,). */
export function rowOf(array, row) {
  return array.values.subarray(row * array.width, (row + 1) * array.width);
}
