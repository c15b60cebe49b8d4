// SPDX-License-Identifier: Apache-2.0
// The hand: its links as capsules, its tips as the hemispheres that touch.

import * as THREE from "three";

const BONE = 0.33; // radius of a link as share of that of the tip

export class HandModel {
  /** Build the tree of links of a run; `colors[i]` is the colour of finger i. */
  constructor(hand, fingers) {
    this.group = new THREE.Group();
    this.radius = hand.tips.length ? hand.tips.reduce((sum, tip) => sum + tip.radius, 0) / hand.tips.length : 0.01;
    this.materials = {
      bone: new THREE.MeshLambertMaterial(),
      joint: new THREE.MeshLambertMaterial(),
      palm: new THREE.MeshLambertMaterial(),
    };
    this.nodes = hand.links.map((link) => makeNode(link));
    hand.links.forEach((link, i) => {
      (link.parent < 0 ? this.group : this.nodes[link.parent].object).add(this.nodes[i].object);
      if (link.parent >= 0) this._dress(hand.links, i);
    });
    this.tips = hand.tips.map((tip, i) => this._tip(tip, i, fingers));
  }

  _dress(links, i) {
    const offset = new THREE.Vector3(...links[i].xyz);
    const fixedToPalm = links[links[i].parent].parent < 0;
    const radius = BONE * this.radius;
    if (offset.length() > radius) {
      const bar = capsule(offset, radius * (fixedToPalm ? 0.8 : 1), fixedToPalm ? this.materials.palm : this.materials.bone);
      this.nodes[links[i].parent].object.add(bar);
    }
    if (links[i].motion === "turn") {
      this.nodes[i].object.add(new THREE.Mesh(new THREE.SphereGeometry(1.28 * radius, 18, 10), this.materials.joint));
    }
  }

  _tip(tip, order, fingers) {
    const named = fingers.findIndex((finger) => finger.name === tip.finger);
    const finger = named >= 0 ? named : Math.min(order, fingers.length - 1);
    const material = new THREE.MeshPhongMaterial({ specular: "#3a3a3a", shininess: 40 });
    const r = tip.radius;
    const shape = new THREE.LatheGeometry(profile(r, BONE * this.radius), 30).rotateZ(-Math.PI / 2);
    const node = new THREE.Object3D(); // at the center of the hemisphere, x toward its top
    const center = new THREE.Vector3(...tip.center);
    node.position.copy(center);
    node.quaternion.setFromUnitVectors(new THREE.Vector3(1, 0, 0), new THREE.Vector3(...tip.axis).normalize());
    node.add(new THREE.Mesh(shape, material));
    const link = this.nodes[tip.link].object;
    link.add(node);
    if (center.length() > r) link.add(capsule(center, BONE * this.radius, this.materials.bone));
    return { finger, material, node, radius: r, color: fingers[finger]?.color ?? "#888888" };
  }

  paint(theme) {
    for (const name of Object.keys(this.materials)) this.materials[name].color.set(theme.get(name));
    this.theme = theme;
    this.alarm(this.slipping ?? []);
  }

  /** Take a posture: joint values in the order of the record. */
  pose(theta) {
    for (const { move, joint, ratio, offset } of this.nodes) move(joint >= 0 ? ratio * theta[joint] + offset : 0);
    this.group.updateMatrixWorld(true);
  }

  /** Let the tips of slipping fingers glow red; `slipping` goes by finger. */
  alarm(slipping) {
    this.slipping = slipping;
    for (const tip of this.tips) {
      const slips = Boolean(slipping[tip.finger]);
      tip.material.color.set(slips ? this.theme.event("slip") : this.theme.data(tip.color));
      tip.material.emissive.set(slips ? "#5c0d0d" : "#000000");
    }
  }

  /** Return where a finger begins: the first moving link on the way to its tip that it shares with no other finger. */
  base(tip) {
    const chain = (node) => (node && node !== this.group ? [...chain(node.parent), node] : []);
    const others = this.tips.filter((other) => other !== tip).map((other) => new Set(chain(other.node)));
    const own = chain(tip.node).filter((node) => !others.some((shared) => shared.has(node)));
    const moving = this.nodes.filter((node) => node.joint >= 0).map((node) => node.object);
    return own.find((node) => moving.includes(node)) ?? own[0] ?? tip.node;
  }

  /** Return where all links are, in the palm frame. */
  points() {
    return this.nodes.map((node) => node.object.getWorldPosition(new THREE.Vector3()));
  }
}

/** Return the outline of a tip, its axis upwards: a hemisphere that runs out into the link. */
function profile(radius, bone) {
  const neck = Array.from({ length: 11 }, (_, i) => {
    const s = 1 - i / 10;
    return new THREE.Vector2(bone + (radius - bone) * Math.cos((s * Math.PI) / 2) ** 2, -1.3 * s * radius);
  });
  const dome = Array.from({ length: 11 }, (_, i) => {
    const angle = ((i + 1) / 11) * (Math.PI / 2);
    return new THREE.Vector2(radius * Math.max(0, Math.cos(angle)), radius * Math.sin(angle));
  });
  return [...neck, ...dome];
}

function makeNode(link) {
  const object = new THREE.Object3D();
  const rest = new THREE.Quaternion(...link.quaternion);
  const place = new THREE.Vector3(...link.xyz);
  object.position.copy(place);
  object.quaternion.copy(rest);
  const axis = link.axis ? new THREE.Vector3(...link.axis).normalize() : null;
  const turn = new THREE.Quaternion();
  const moves = {
    turn: (value) => object.quaternion.copy(rest).multiply(turn.setFromAxisAngle(axis, value)),
    slide: (value) => object.position.copy(axis).multiplyScalar(value).applyQuaternion(rest).add(place),
  };
  const act = moves[link.motion];
  const move = (value) => act && Number.isFinite(value) && act(value);
  return { object, joint: link.joint ?? -1, ratio: link.ratio ?? 1, offset: link.offset ?? 0, move };
}

function capsule(offset, radius, material) {
  const length = offset.length();
  const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(radius, length, 4, 16).translate(0, length / 2, 0), material);
  mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), offset.clone().normalize());
  return mesh;
}
