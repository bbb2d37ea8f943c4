"use strict";
// Sleeve, forearm and hand of one side, with a mitten where the skeleton has no fingers.

const FINGERS = ["thumb", "index", "middle", "ring", "pinky"];
const FINGER_RADII = { thumb: 0.0132, index: 0.0112, middle: 0.0116, ring: 0.0111, pinky: 0.0098 };
// [place along the joints, radius] from the neck over shoulder (1) and elbow (2) to the cuff.
const SLEEVE = [
  [0, 0.036], [0.25, 0.042], [0.5, 0.048], [0.7, 0.0525], [0.85, 0.0555], [0.95, 0.057], [1.03, 0.0575], [1.1, 0.057],
  [1.2, 0.0555], [1.32, 0.053], [1.48, 0.0495], [1.64, 0.046], [1.77, 0.044], [1.87, 0.043], [1.95, 0.0428],
  [2.03, 0.0428], [2.12, 0.043], [2.24, 0.0425], [2.4, 0.04], [2.58, 0.0362], [2.74, 0.0333], [2.83, 0.0322],
  [2.89, 0.0327],
];
const FOREARM = [[0.8, 0.0265], [0.9, 0.0245], [1, 0.0235]];
const MITTEN = [[0, 0.024], [0.35, 0.03], [0.7, 0.03], [1, 0.021]];
// [place along the joints, factor of the finger's radius]; 0 to 1 is in the palm.
const THUMB_ROOT = [[0, 1.35], [0.4, 1.5], [0.8, 1.4]];
const FINGER_ROOT = [[0, 1.05], [0.5, 1.1]];
const FINGER = [
  [1, 1.12], [1.3, 1.06], [1.7, 1], [2, 1.03], [2.4, 0.97], [2.8, 0.95], [3, 0.97], [3.5, 0.92], [3.85, 0.74],
];
const TIP = 0.024; // metres past the last joint of a finger

class Arm {
  constructor(side, paint, joint) {
    Object.assign(this, { side, joint });
    this.sleeve = new Tube(SLEEVE, 24, paint.shirt, 3);
    this.forearm = new Tube(FOREARM, 20, paint.skin, 0);
    this.fingers = new Map();
    if (joint(`${side}_index_1`)) {
      this.palm = new Loft(9, 28, paint.skin, 0.8);
      for (const finger of FINGERS) {
        const factors = [...(finger === "thumb" ? THUMB_ROOT : FINGER_ROOT), ...FINGER];
        const profile = factors.map(([place, factor]) => [place, factor * FINGER_RADII[finger]]);
        this.fingers.set(finger, new Tube(profile, 14, paint.skin, 1));
      }
    } else {
      this.mitten = new Tube(MITTEN, 20, paint.skin, 0);
    }
  }

  get meshes() {
    const parts = [this.sleeve, this.forearm, this.palm, this.mitten, ...this.fingers.values()];
    return parts.filter(Boolean).map((part) => part.mesh);
  }

  pose(up) {
    const [shoulder, elbow, wrist] = ["shoulder", "elbow", "wrist"].map((name) => this.joint(`${this.side}_${name}`));
    const collar = this.joint("neck").clone().lerp(shoulder, 0.3).addScaledVector(up, 0.008);
    this.sleeve.pose([collar, shoulder, elbow, wrist]);
    this.forearm.pose([elbow, wrist]);
    if (this.mitten) {
      const ahead = unit(wrist.clone().sub(elbow));
      this.mitten.pose([wrist, wrist.clone().addScaledVector(ahead, 0.15)]);
      return;
    }
    for (const [finger, tube] of this.fingers) this.poseFinger(finger, tube, wrist);
    this.posePalm(wrist);
  }

  poseFinger(finger, tube, wrist) {
    const [first, second, third] = [1, 2, 3].map((part) => this.joint(`${this.side}_${finger}_${part}`));
    // Skeletons have no fingertips; the bend of the finger is continued.
    const before = unit(second.clone().sub(first)), last = unit(third.clone().sub(second));
    const ahead = unit(last.multiplyScalar(1.4).addScaledVector(before, -0.4));
    const tip = third.clone().addScaledVector(ahead, TIP);
    tube.pose([wrist.clone().lerp(first, finger === "thumb" ? 0.25 : 0.5), first, second, third, tip]);
  }

  // Flat boxes from the wrist to the knuckles, as wide as the distance between these.
  posePalm(wrist) {
    const [index, middle, ring, pinky] = FINGERS.slice(1).map((finger) => this.joint(`${this.side}_${finger}_1`));
    const along = index.clone().add(middle).add(ring).add(pinky).multiplyScalar(0.25).sub(wrist);
    const reach = along.length();
    unit(along);
    const across = index.clone().sub(pinky);
    const wide = across.length() / 2 + 0.008;
    unit(across.addScaledVector(along, -across.dot(along)));
    const through = new THREE.Vector3().crossVectors(along, across);
    [
      [-0.1, 0.01, 0.008], [-0.05, 0.0215, 0.0175], [0.02, 0.0245, 0.0195], [0.22, 0.6 * wide + 0.011, 0.0185],
      [0.45, 0.85 * wide + 0.006, 0.0165], [0.7, wide + 0.001, 0.0145], [0.9, wide - 0.001, 0.0125],
      [1, wide - 0.006, 0.0095], [1.03, 0.6 * wide, 0.004],
    ].forEach(([fraction, half, thick], ring) => {
      const centre = wrist.clone().addScaledVector(along, fraction * reach);
      this.palm.setRing(ring, centre, across.clone().multiplyScalar(half), through.clone().multiplyScalar(thick));
    });
    this.palm.finish();
  }
}
