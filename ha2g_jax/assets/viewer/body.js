"use strict";
// A dressed figure. The positions of the joints are never changed; the body is drawn around them.

// Height above the spine, half width, half depth, offset to the front, fraction of the tilt of the chest, opacity.
const TRUNK = [
  [-0.43, 0.178, 0.124, -0.01, 0, 0], [-0.4, 0.179, 0.125, -0.01, 0, 0.15], [-0.35, 0.179, 0.124, -0.01, 0, 0.6],
  [-0.29, 0.174, 0.119, -0.008, 0, 1], [-0.2, 0.16, 0.11, -0.002, 0.1, 1], [-0.11, 0.151, 0.105, 0.004, 0.35, 1],
  [-0.02, 0.154, 0.106, 0.008, 0.7, 1], [0.06, 0.165, 0.111, 0.01, 0.95, 1], [0.13, 0.177, 0.113, 0.01, 1, 1],
  [0.185, 0.182, 0.108, 0.006, 1, 1], [0.225, 0.176, 0.096, 0, 1, 1], [0.255, 0.155, 0.083, -0.004, 1, 1],
  [0.28, 0.118, 0.072, -0.006, 1, 1], [0.297, 0.086, 0.066, -0.005, 1, 1], [0.309, 0.0665, 0.0625, -0.003, 1, 1],
  [0.318, 0.0615, 0.059, -0.002, 1, 1], [0.316, 0.056, 0.054, -0.002, 1, 1], [0.3, 0.025, 0.025, -0.002, 1, 1],
];

class Body {
  constructor(motion, colour) {
    this.motion = motion;
    this.index = new Map(motion.joints.map((name, i) => [name, i]));
    this.points = motion.joints.map(() => new THREE.Vector3());
    this.group = new THREE.Group();
    this.paint = makePaint(colour);
    this.trunk = this.keep(new Loft(TRUNK.length, 44, this.paint.trunk, 0.86));
    this.fadeTrunk();
    this.neck = this.keep(new Tube([[0, 0.060], [0.3, 0.054], [0.7, 0.052], [1, 0.054]], 24, this.paint.skin, 0));
    this.head = makeHead(this.paint);
    this.head.scale.setScalar(1.2);
    this.head.matrixAutoUpdate = false;
    this.group.add(this.head);
    this.arms = ["left", "right"].map((side) => new Arm(side, this.paint, (name) => this.joint(name)));
    for (const arm of this.arms) this.group.add(...arm.meshes);
    this.makeSticks();
  }

  keep(part) {
    this.group.add(part.mesh);
    return part;
  }

  joint(name) {
    return this.points[this.index.get(name)];
  }

  pose(positions) {
    this.points.forEach((point, i) => point.fromArray(positions, 3 * i));
    this.poseTrunk();
    this.poseHead();
    for (const arm of this.arms) arm.pose(this.up);
    this.poseSticks();
  }

  // The chest follows spine, neck and shoulders; the hips rotate with it but stay upright.
  poseTrunk() {
    const spine = this.joint("spine"), neck = this.joint("neck");
    const up = unit(neck.clone().sub(spine));
    const across = this.joint("left_shoulder").clone().sub(this.joint("right_shoulder"));
    unit(across.addScaledVector(up, -across.dot(up)));
    const level = unit(across.clone().setY(0));
    const stretch = neck.distanceTo(spine) / 0.26, world = new THREE.Vector3(0, 1, 0);
    this.up = up; this.across = across; this.ahead = new THREE.Vector3().crossVectors(across, up);
    // The trunk bends: each ring is placed on the one below.
    const centre = spine.clone(), start = TRUNK.findIndex(([height]) => height > -0.03);
    const place = (i, from) => {
      const [height, wide, deep, forward, tilt] = TRUNK[i];
      const ringUp = unit(world.clone().lerp(up, tilt)), ringAcross = level.clone().lerp(across, tilt);
      unit(ringAcross.addScaledVector(ringUp, -ringAcross.dot(ringUp)));
      const ringAhead = new THREE.Vector3().crossVectors(ringAcross, ringUp);
      centre.addScaledVector(ringUp, (height - from) * (height > 0 ? stretch : 1));
      const middle = centre.clone().addScaledVector(ringAhead, forward);
      this.trunk.setRing(i, middle, ringAcross.multiplyScalar(-wide), ringAhead.multiplyScalar(deep));
    };
    for (let i = start; i < TRUNK.length; i++) place(i, i === start ? 0 : TRUNK[i - 1][0]);
    centre.copy(spine);
    for (let i = start - 1; i >= 0; i--) place(i, i === start - 1 ? 0 : TRUNK[i + 1][0]);
    this.trunk.finish();
  }

  poseHead() {
    const neck = this.joint("neck"), nose = this.joint("nose");
    let left, up, ahead, centre;
    if (this.index.has("left_ear")) {
      const ears = this.joint("left_ear").clone().add(this.joint("right_ear")).multiplyScalar(0.5);
      left = unit(this.joint("left_ear").clone().sub(this.joint("right_ear")));
      ahead = nose.clone().sub(ears);
      unit(ahead.addScaledVector(left, -ahead.dot(left)));
      up = new THREE.Vector3().crossVectors(ahead, left);
      // The nose is below the ears, so the line between them is levelled.
      const tilt = (18 * Math.PI) / 180, forward = ahead.clone();
      ahead.multiplyScalar(Math.cos(tilt)).addScaledVector(up, Math.sin(tilt));
      up.multiplyScalar(Math.cos(tilt)).addScaledVector(forward, -Math.sin(tilt));
      centre = ears.addScaledVector(ahead, 0.03);
    } else {
      up = unit(this.joint("head").clone().sub(neck));
      left = this.across.clone();
      ahead = nose.clone().sub(neck);
      unit(ahead.addScaledVector(up, -ahead.dot(up)).addScaledVector(left, -0.7 * ahead.dot(left)));
      left = new THREE.Vector3().crossVectors(up, ahead);
      centre = neck.clone().addScaledVector(up, 0.2).addScaledVector(ahead, 0.02);
    }
    this.head.matrix.makeBasis(left, up, ahead).scale(this.head.scale).setPosition(centre);
    const low = neck.clone().addScaledVector(this.up, -0.01).addScaledVector(this.ahead, 0.004);
    this.neck.pose([low, centre.clone().addScaledVector(up, -0.065).addScaledVector(ahead, -0.018)]);
  }

  fadeTrunk() {
    const sides = this.trunk.sides, colours = new Float32Array(4 * TRUNK.length * sides).fill(1);
    TRUNK.forEach((ring, i) => {
      for (let s = 0; s < sides; s++) colours[4 * (i * sides + s) + 3] = ring[5];
    });
    this.trunk.mesh.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 4));
    this.trunk.mesh.renderOrder = 1;
  }

  makeSticks() {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * this.points.length), 3));
    geometry.setIndex(this.motion.bones.flat());
    const lines = new THREE.LineSegments(geometry, this.paint.sticks);
    const dots = new THREE.Points(geometry, this.paint.dots);
    this.sticks = new THREE.Group();
    this.sticks.add(lines, dots);
    for (const part of [lines, dots]) { part.frustumCulled = false; part.renderOrder = 3; }
    this.sticks.visible = false;
    this.group.add(this.sticks);
  }

  poseSticks() {
    const positions = this.sticks.children[0].geometry.attributes.position;
    this.points.forEach((point, i) => positions.setXYZ(i, point.x, point.y, point.z));
    positions.needsUpdate = true;
  }

  // Bones are drawn through the body; of a figure over another one only the arms are drawn, translucent.
  show({ hasSticks, isGhost }) {
    const opacity = hasSticks ? 0.28 : isGhost ? 0.5 : 1;
    for (const [name, material] of Object.entries(this.paint)) {
      if (name === "sticks" || name === "dots") continue;
      material.opacity = opacity;
      material.transparent = opacity < 1 || name === "trunk";
      material.needsUpdate = true;
    }
    for (const part of [this.trunk.mesh, this.neck.mesh, this.head]) part.visible = !isGhost;
    this.sticks.visible = hasSticks;
  }
}

function unit(vector) {
  return vector.divideScalar(Math.max(vector.length(), 1e-8));
}

function makePaint(colour) {
  const matt = (hex, roughness, more = {}) => new THREE.MeshStandardMaterial({
    color: new THREE.Color(hex).convertSRGBToLinear(), roughness, metalness: 0, ...more,
  });
  const seen = { color: 0xff5a36, depthTest: false, transparent: true };
  return {
    skin: matt(0xe3b494, 0.62), hair: matt(0x4a342a, 0.75), white: matt(0xf4f1ec, 0.35), iris: matt(0x33241e, 0.25),
    lid: matt(0xd6a587, 0.7), lips: matt(0xb3766a, 0.6), shirt: matt(colour, 0.85),
    trunk: matt(colour, 0.85, { transparent: true, vertexColors: true }),
    sticks: new THREE.LineBasicMaterial(seen),
    dots: new THREE.PointsMaterial({ ...seen, size: 5, sizeAttenuation: false }),
  };
}
