"use strict";
// Closed smooth surfaces through rings, updated in every frame: sleeves, fingers, palms, the trunk, the neck.

class Loft {
  // A `corner` below 1 makes the rings more rectangular.
  constructor(rings, sides, material, corner = 1) {
    this.rings = rings;
    this.sides = sides;
    const power = (value) => Math.sign(value) * Math.abs(value) ** corner;
    const angles = [...Array(sides).keys()].map((side) => (2 * Math.PI * side) / sides);
    this.circle = angles.map((angle) => [power(Math.cos(angle)), power(Math.sin(angle))]);
    const geometry = new THREE.BufferGeometry();
    const faces = [];
    for (let ring = 0; ring + 1 < rings; ring++) {
      for (let side = 0; side < sides; side++) {
        const next = (side + 1) % sides, low = ring * sides, high = low + sides;
        faces.push(low + side, low + next, high + side, low + next, high + next, high + side);
      }
    }
    geometry.setIndex(faces);
    this.points = new THREE.BufferAttribute(new Float32Array(3 * rings * sides), 3).setUsage(THREE.DynamicDrawUsage);
    this.normals = new THREE.BufferAttribute(new Float32Array(3 * rings * sides), 3).setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("position", this.points);
    geometry.setAttribute("normal", this.normals);
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false; // its bounds move
    this.mesh.castShadow = this.mesh.receiveShadow = true;
  }

  // An ellipse with half axes `across` and `ahead`, anticlockwise as seen from the end of the surface.
  setRing(ring, centre, across, ahead) {
    const array = this.points.array;
    let i = 3 * ring * this.sides;
    for (const [u, v] of this.circle) {
      array[i++] = centre.x + u * across.x + v * ahead.x;
      array[i++] = centre.y + u * across.y + v * ahead.y;
      array[i++] = centre.z + u * across.z + v * ahead.z;
    }
  }

  // Normals of a grid: the cross product of the directions around and along.
  finish() {
    const p = this.points.array, n = this.normals.array, { rings, sides } = this;
    for (let ring = 0; ring < rings; ring++) {
      const low = 3 * sides * Math.max(ring - 1, 0), high = 3 * sides * Math.min(ring + 1, rings - 1);
      for (let side = 0; side < sides; side++) {
        const back = 3 * (ring * sides + ((side + sides - 1) % sides)), on = 3 * (ring * sides + ((side + 1) % sides));
        const l = low + 3 * side, h = high + 3 * side, i = 3 * (ring * sides + side);
        const ax = p[on] - p[back], ay = p[on + 1] - p[back + 1], az = p[on + 2] - p[back + 2];
        const bx = p[h] - p[l], by = p[h + 1] - p[l + 1], bz = p[h + 2] - p[l + 2];
        const x = ay * bz - az * by, y = az * bx - ax * bz, z = ax * by - ay * bx;
        const length = Math.sqrt(x * x + y * y + z * z) || 1;
        n[i] = x / length; n[i + 1] = y / length; n[i + 2] = z / length;
      }
    }
    this.points.needsUpdate = this.normals.needsUpdate = true;
  }
}

// A tube along a chain of joints, with rounded corners and ends.
class Tube {
  // `profile`: [place along the chain (joint number and fraction of the bone after it), radius in metres] in order.
  constructor(profile, sides, material, rounding = 2) {
    this.profile = profile;
    this.rounding = rounding;
    this.loft = new Loft(profile.length + 6, sides, material);
    this.mesh = this.loft.mesh;
    this.line = profile.map(() => new THREE.Vector3());
  }

  pose(chain) {
    const line = this.line, last = line.length - 1;
    this.profile.forEach(([place], i) => {
      const bone = Math.min(Math.floor(place), chain.length - 2);
      line[i].lerpVectors(chain[bone], chain[bone + 1], place - bone);
    });
    for (let pass = 0; pass < this.rounding; pass++) {
      let before = line[0].clone();
      for (let i = 1; i < last; i++) {
        const here = line[i].clone();
        line[i].multiplyScalar(0.5).addScaledVector(before, 0.25).addScaledVector(line[i + 1], 0.25);
        before = here;
      }
    }
    // The frame is transported along the line without twist.
    const along = new THREE.Vector3().subVectors(line[1], line[0]).normalize();
    const across = new THREE.Vector3(Math.abs(along.x) > 0.9 ? 0 : 1, Math.abs(along.x) > 0.9 ? 1 : 0, 0);
    for (let i = 0; i <= last; i++) {
      along.subVectors(line[Math.min(i + 1, last)], line[Math.max(i - 1, 0)]).normalize();
      across.addScaledVector(along, -across.dot(along)).normalize();
      const ahead = new THREE.Vector3().crossVectors(along, across);
      const radius = this.profile[i][1];
      if (i === 0) this.cap(0, line[0], along, across, ahead, radius, -1);
      this.ring(i + 3, line[i], across, ahead, radius);
      if (i === last) this.cap(i + 4, line[i], along, across, ahead, radius, 1);
    }
    this.loft.finish();
  }

  ring(index, centre, across, ahead, radius) {
    this.loft.setRing(index, centre, across.clone().multiplyScalar(radius), ahead.clone().multiplyScalar(radius));
  }

  cap(index, end, along, across, ahead, radius, sign) {
    const angles = sign < 0 ? [1.55, 1.1, 0.55] : [0.55, 1.1, 1.55];
    angles.forEach((angle, i) => {
      const centre = end.clone().addScaledVector(along, sign * radius * Math.sin(angle));
      this.ring(index + i, centre, across, ahead, radius * Math.cos(angle));
    });
  }
}
