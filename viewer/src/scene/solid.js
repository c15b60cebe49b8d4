// SPDX-License-Identifier: Apache-2.0
// The object: a translucent polyhedron with its edges, and the ghost of where it is wanted.

import * as THREE from "three";
import { segments } from "./lines.js";

/** The polyhedron as it is. */
export class Solid {
  constructor(shape) {
    this.group = new THREE.Group();
    this.vertices = shape.vertices;
    const faces = faceGeometry(shape);
    const look = { transparent: true, depthWrite: false };
    this.back = new THREE.MeshLambertMaterial({ ...look, opacity: 0.22, side: THREE.BackSide });
    this.front = new THREE.MeshLambertMaterial({ ...look, opacity: 0.26, side: THREE.FrontSide });
    const meshes = [this.back, this.front].map((material) => new THREE.Mesh(faces, material));
    this.edges = segments(edgePoints(shape), { linewidth: 2.2, transparent: true, opacity: 0.9 });
    meshes[0].renderOrder = 1;
    meshes[1].renderOrder = 5;
    this.edges.renderOrder = 2;
    this.group.add(...meshes, this.edges);
  }

  /** Return where the corners are now. */
  corners() {
    this.group.updateMatrix();
    return this.vertices.map((vertex) => new THREE.Vector3(...vertex).applyMatrix4(this.group.matrix));
  }

  paint(theme) {
    for (const material of [this.back, this.front]) material.color.set(theme.get("solid"));
    this.edges.material.color.set(theme.get("edge"));
  }
}

/** The edges of the polyhedron where it is to be. */
export class Ghost {
  constructor(shape, size) {
    this.edges = segments(edgePoints(shape), { linewidth: 1.6, dashed: true, dashSize: 0.05 * size, gapSize: 0.035 * size, transparent: true, opacity: 0.95 });
    this.group = new THREE.Group().add(this.edges);
  }

  paint(theme) {
    this.edges.material.color.set(theme.get("goal"));
  }
}

function faceGeometry({ vertices, faces }) {
  const points = faces.flatMap((corners) =>
    corners.slice(2).flatMap((_, i) => [corners[0], corners[i + 1], corners[i + 2]].flatMap((corner) => vertices[corner])),
  );
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  geometry.computeVertexNormals();
  return geometry;
}

function edgePoints({ vertices, edges }) {
  return edges.flatMap(([from, to]) => [...vertices[from], ...vertices[to]]);
}
