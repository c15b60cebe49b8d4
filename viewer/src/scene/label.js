// SPDX-License-Identifier: Apache-2.0
// The number of a finger beside its base.

import * as THREE from "three";

const SIZE = 128;

export class Badge {
  constructor(text, color, size) {
    this.text = text;
    this.color = color;
    this.size = size;
    this.canvas = document.createElement("canvas");
    this.canvas.width = this.canvas.height = SIZE;
    this.texture = new THREE.CanvasTexture(this.canvas);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    this.group = new THREE.Sprite(new THREE.SpriteMaterial({ map: this.texture, depthTest: false, transparent: true }));
    this.group.scale.setScalar(size);
    this.group.renderOrder = 10;
  }

  paint(theme) {
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, SIZE, SIZE);
    pen.fillStyle = theme.data(this.color);
    pen.beginPath();
    pen.arc(SIZE / 2, SIZE / 2, 0.46 * SIZE, 0, 2 * Math.PI);
    pen.fill();
    pen.fillStyle = theme.get("label");
    pen.font = `600 ${0.58 * SIZE}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(this.text, SIZE / 2, 0.53 * SIZE);
    this.texture.needsUpdate = true;
  }
}
