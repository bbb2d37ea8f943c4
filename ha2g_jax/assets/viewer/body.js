"use strict";
// The figure: a mesh that moves with the joints, see pack_body in ha2g_jax/viewer/packing.py, and its bones as lines.

// Joints whose rotation follows from several joints: the one ahead of them, and two that are side by side.
const FRAMES = {
  spine: ["neck", "right_shoulder", "left_shoulder"], head: ["nose", "right_ear", "left_ear"],
  nose_0: ["head", "neck", "nose"],
  left_wrist: ["left_middle_1", "left_pinky_1", "left_index_1"],
  right_wrist: ["right_middle_1", "right_pinky_1", "right_index_1"],
};
const EDGE = 0.0028; // metres; width of the dark line around a part
const MATERIALS = { skin: 0.62, iris: 0.25, eye_white: 0.35 }; // roughness, of others 0.85
const ARM = /^(left|right)_(shoulder|elbow|wrist|thumb|index|middle|ring|pinky)/;

class Body {
  constructor(motion, shirt, onready) {
    this.motion = motion;
    this.index = new Map(motion.joints.map((name, i) => [name, i]));
    this.points = motion.joints.map(() => new THREE.Vector3());
    this.group = new THREE.Group();
    this.makeSticks();
    this.meshes = [];
    this.makeBones(motion.body.joints);
    this.makeMeshes(motion.body, shirt).then(onready);
  }

  joint(name) {
    return this.points[this.index.get(name)];
  }

  // The tree of joints of the mesh: those of the motion, and others at the same places that rotate one bone each.
  makeBones(joints) {
    const at = (place) => new THREE.Vector3(...place);
    this.bones = joints.map(([name, parent, place]) => ({
      name, parent: this.bones?.[parent], up: parent, rest: at(place), place: new THREE.Vector3(),
      turn: new THREE.Quaternion(), node: new THREE.Bone(),
    }));
    const named = new Map(this.bones.map((bone) => [bone.name, bone]));
    this.bones.forEach((bone, i) => {
      bone.parent = this.bones[bone.up];
      const frame = FRAMES[bone.name]?.map((name) => named.get(name));
      if (frame?.every(Boolean)) Object.assign(bone, { frame, back: basis(bone, frame, "rest").invert() });
      const ends = this.bones.filter(({ up, rest }) => up === i && rest.distanceTo(bone.rest) > 0);
      if (ends.length === 1) [bone.end] = ends;
    });
    const inverses = this.bones.map(({ rest }) => new THREE.Matrix4().makeTranslation(-rest.x, -rest.y, -rest.z));
    this.skeleton = new THREE.Skeleton(this.bones.map(({ node }) => node), inverses);
  }

  async makeMeshes({ parts, ...packed }, shirt) {
    const [points, bindings, faces] = await Promise.all(["points", "bindings", "faces"].map((name) => inflated(packed[name])));
    const count = bindings.length / 8, places = sums(points, count), corners = sums(faces, faces.length);
    let first = 0, face = 0;
    for (const [name, colour, size, number] of parts) {
      const geometry = new THREE.BufferGeometry(), of = (start) => bindings.subarray(4 * start, 4 * (start + size));
      const place = Float32Array.from({ length: 3 * size }, (_, i) => places[(i % 3) * count + first + Math.floor(i / 3)] / 1e4);
      geometry.setAttribute("position", new THREE.BufferAttribute(place, 3));
      geometry.setAttribute("skinIndex", new THREE.BufferAttribute(of(first), 4));
      geometry.setAttribute("skinWeight", new THREE.BufferAttribute(of(count + first), 4, true));
      geometry.setIndex(new THREE.BufferAttribute(Uint16Array.from(corners.subarray(face, face + 3 * number)), 1));
      geometry.computeVertexNormals();
      this.addMesh(geometry, name, new THREE.Color(name === "shirt" ? shirt : colour));
      first += size;
      face += 3 * number;
    }
    this.show(this.look || {});
  }

  addMesh(geometry, name, colour) {
    const linear = colour.clone().convertSRGBToLinear();
    const paint = new THREE.MeshStandardMaterial({ color: linear, roughness: MATERIALS[name] || 0.85 });
    const mesh = new THREE.SkinnedMesh(geometry, paint);
    mesh.castShadow = mesh.receiveShadow = true;
    const edge = new THREE.SkinnedMesh(geometry, edgeOf(colour));
    for (const part of [mesh, edge]) {
      part.bind(this.skeleton, new THREE.Matrix4());
      part.frustumCulled = false; // its bounds move
      this.group.add(part);
    }
    // Of a figure over another one only the arms are drawn.
    const { array } = geometry.index, joints = geometry.attributes.skinIndex.array;
    const isArm = (corner) => ARM.test(this.bones[joints[4 * corner]].name);
    const arms = array.filter((_, i) => isArm(array[i - (i % 3)]));
    this.meshes.push({ mesh, edge, whole: geometry.index, arms: new THREE.BufferAttribute(arms, 1) });
  }

  pose(positions) {
    this.points.forEach((point, i) => point.fromArray(positions, 3 * i));
    for (const bone of this.bones) bone.place.copy(this.joint(bone.name) || bone.parent.place);
    for (const bone of this.bones) this.turn(bone);
    for (const { node, place, turn } of this.bones) node.matrixWorld.compose(place, turn, new THREE.Vector3(1, 1, 1));
    this.poseSticks();
  }

  turn(bone) {
    if (bone.parent) bone.turn.copy(bone.parent.turn);
    if (bone.frame) {
      bone.turn.setFromRotationMatrix(basis(bone, bone.frame, "place").multiply(bone.back));
      if (bone.parent?.end === bone) shareTwist(bone.parent, bone);
    } else if (bone.name === "hips") {
      // They turn with the trunk and lean half as much.
      const up = new THREE.Vector3(0, 1, 0).applyQuaternion(bone.turn), half = up.clone();
      half.y += 1;
      bone.turn.premultiply(new THREE.Quaternion().setFromUnitVectors(up, half.normalize()));
    } else if (bone.end) {
      const before = bone.end.rest.clone().sub(bone.rest).normalize().applyQuaternion(bone.turn);
      const now = bone.end.place.clone().sub(bone.place).normalize();
      bone.turn.premultiply(new THREE.Quaternion().setFromUnitVectors(before, now));
    }
  }

  makeSticks() {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * this.points.length), 3));
    geometry.setIndex(this.motion.bones.flat());
    const seen = { color: 0xff5a36, depthTest: false, transparent: true };
    const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial(seen));
    const dots = new THREE.Points(geometry, new THREE.PointsMaterial({ ...seen, size: 5, sizeAttenuation: false }));
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

  // Bones are drawn through the body; the arms over another figure are translucent.
  show(look) {
    this.look = look;
    const { hasSticks, isGhost } = look, opacity = hasSticks ? 0.28 : isGhost ? 0.5 : 1;
    for (const { mesh, edge, whole, arms } of this.meshes) {
      Object.assign(mesh.material, { opacity, transparent: opacity < 1, needsUpdate: true });
      mesh.geometry.setIndex(isGhost ? arms : whole);
      edge.visible = opacity === 1;
    }
    this.sticks.visible = Boolean(hasSticks);
  }
}

// The numbers of which `bytes` has the differences along rows of a length, int16.
function sums(bytes, length) {
  const numbers = new Int32Array(new Int16Array(bytes.buffer));
  for (let i = 1; i < numbers.length; i++) if (i % length) numbers[i] += numbers[i - 1];
  return numbers;
}

// Axes of which the first points from a bone to the joint ahead, and the second nearly from one joint to the other.
function basis(bone, [ahead, one, other], key) {
  const x = ahead[key].clone().sub(bone[key]).normalize(), z = new THREE.Vector3();
  z.crossVectors(x, other[key].clone().sub(one[key])).normalize();
  return new THREE.Matrix4().makeBasis(x, new THREE.Vector3().crossVectors(z, x), z);
}

// Turns the forearm about its length by half of the turn of the hand, so that the skin between them is not wrung.
function shareTwist(forearm, hand) {
  const along = hand.rest.clone().sub(forearm.rest).normalize();
  const between = forearm.turn.clone().invert().multiply(hand.turn);
  const angle = 2 * Math.atan2(along.dot(between), between.w);
  const half = Math.atan2(Math.sin(angle), Math.cos(angle)) / 2;
  forearm.turn.multiply(new THREE.Quaternion().setFromAxisAngle(along, half));
}

// The inside of a part that is a little larger, which is seen as a line around it.
function edgeOf(colour) {
  const paint = new THREE.MeshBasicMaterial({
    color: colour.clone().convertSRGBToLinear().multiplyScalar(0.5), side: THREE.BackSide,
  });
  paint.onBeforeCompile = (shader) => {
    const code = `transformed += ${EDGE} * normal;\n#include <skinning_vertex>`;
    shader.vertexShader = shader.vertexShader.replace("#include <skinning_vertex>", code);
  };
  return paint;
}
