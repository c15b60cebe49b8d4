// SPDX-License-Identifier: Apache-2.0
// Bundles src/ into the Python package; the head of each file says of which source it is made.

import { createHash } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { build } from "esbuild";

const OUT = "../tactile_hand_ros/report";
const FIXED = ["build.mjs", "package.json", "package-lock.json"];

/** Return all source files, sorted by name, with / between folders. */
function sources() {
  const found = readdirSync("src", { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => join(entry.parentPath, entry.name).replaceAll("\\", "/"));
  return [...FIXED, ...found].sort();
}

/** Return the digest of names and contents of the sources. */
function digest() {
  const hash = createHash("sha256");
  for (const name of sources()) hash.update(`${name}\0`).update(readFileSync(name)).update("\0");
  return hash.digest("hex");
}

function notice(name) {
  const { version } = JSON.parse(readFileSync(`node_modules/${name}/package.json`, "utf8"));
  return `${name} ${version}\n\n${readFileSync(`node_modules/${name}/LICENSE`, "utf8").trim()}`;
}

const head = `/*! tactile_hand_ros report viewer, Apache-2.0
source sha256 ${digest()}
contains:

${notice("three")}

${notice("uplot")}
*/`;

await build({
  entryPoints: { viewer: "src/main.js" },
  outdir: OUT,
  bundle: true,
  minify: true,
  format: "iife",
  target: ["es2022", "chrome109", "firefox115", "safari16.4"],
  charset: "ascii",
  legalComments: "inline",
  banner: { js: head, css: head },
  logLevel: "info",
});
