// SPDX-License-Identifier: Apache-2.0
// The plane of the palm: a grid that fades out, so that depth can be judged.

import * as THREE from "three";

const VERTEX = "varying vec2 place; void main() { place = position.xy; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }";
const FRAGMENT = `
  varying vec2 place; uniform vec3 color; uniform float cell; uniform float reach;
  float rule(float size) {
    vec2 p = place / size;
    vec2 near = abs(fract(p - 0.5) - 0.5) / fwidth(p);
    return 1.0 - min(min(near.x, near.y), 1.0);
  }
  void main() {
    float fade = 1.0 - smoothstep(0.25 * reach, reach, length(place));
    gl_FragColor = vec4(color, fade * max(0.75 * rule(5.0 * cell), 0.4 * rule(cell)));
    #include <colorspace_fragment>
  }`;

export class Ground {
  /** `cell` is the distance of the lines and `reach` where they have faded, both in m. */
  constructor(cell, reach) {
    this.material = new THREE.ShaderMaterial({
      uniforms: { color: { value: new THREE.Color() }, cell: { value: cell }, reach: { value: reach } },
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      transparent: true,
      depthWrite: false,
      side: THREE.DoubleSide,
    });
    this.group = new THREE.Mesh(new THREE.CircleGeometry(reach, 48), this.material);
  }

  paint(theme) {
    this.material.uniforms.color.value.set(theme.get("line"));
  }
}
