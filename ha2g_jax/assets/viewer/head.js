"use strict";
// The head in its own axes: +x the person's left, +y up, +z ahead, metres, the origin between the ears.

function makeHead(paint) {
  const head = new THREE.Group();
  const add = (geometry, material, place = [0, 0, 0]) => {
    const mesh = new THREE.Mesh(geometry, material);
    mesh.position.set(...place);
    mesh.castShadow = mesh.receiveShadow = true;
    head.add(mesh);
    return mesh;
  };
  add(shaped(skull, 44, 36), paint.skin);
  add(shaped(hair, 88, 66), paint.hair);
  for (const side of [-1, 1]) {
    const ear = add(new THREE.SphereGeometry(1, 20, 16), paint.skin, [side * 0.081, -0.006, -0.006]);
    ear.scale.set(0.010, 0.030, 0.018);
    ear.rotation.set(0.15, side * 0.35, side * -0.12);
    const white = add(new THREE.SphereGeometry(0.0145, 24, 18), paint.white, [side * 0.031, 0.006, 0.0735]);
    white.scale.set(1.08, 0.88, 0.55);
    const iris = add(new THREE.SphereGeometry(0.0082, 20, 16), paint.iris, [side * 0.0307, 0.0062, 0.0787]);
    iris.scale.set(1, 1, 0.5);
    const lid = add(new THREE.SphereGeometry(0.0152, 24, 12, 0, 2 * Math.PI, 0, 1.05), paint.lid,
      [side * 0.031, 0.0065, 0.0733]);
    lid.scale.set(1.1, 0.92, 0.6);
    lid.rotation.x = 0.1;
    add(bow([[0.014, 0.0285, 0.0832], [0.030, 0.0350, 0.0768], [0.049, 0.0300, 0.0650]], side, 0.0033), paint.hair);
  }
  add(shaped(nose, 24, 20), paint.skin, [0, -0.022, 0.088]);
  add(bow([[-0.021, -0.0530, 0.0716], [0, -0.0580, 0.0768], [0.021, -0.0530, 0.0716]], 1, 0.0033), paint.lips);
  return head;
}

// A sphere whose points (unit vectors) are moved by a function.
function shaped(shape, around, down) {
  const geometry = new THREE.SphereGeometry(1, around, down);
  const points = geometry.attributes.position;
  const point = new THREE.Vector3();
  for (let i = 0; i < points.count; i++) {
    shape(point.fromBufferAttribute(points, i));
    points.setXYZ(i, point.x, point.y, point.z);
  }
  geometry.computeVertexNormals();
  return geometry;
}

function skull(point) {
  const { x, y, z } = point;
  const low = Math.max(0, -y), front = Math.max(0, z);
  const jaw = 1 - 0.34 * low ** 1.6 - 0.10 * low * front;
  point.set(
    0.080 * x * jaw,
    y > 0 ? 0.104 * y : 0.104 * y * (1 - 0.02 * front),
    0.094 * z * (z > 0 ? 1 - 0.06 * low ** 2 : 1 - 0.42 * low ** 1.5) - 0.006 + 0.012 * low * low * front,
  );
}

// The skull a little larger, and below its surface at the face and the neck.
function hair(point) {
  const { x, y, z } = point;
  skull(point);
  const line = z > 0 ? 0.50 + 0.10 * x - 0.62 * Math.abs(x) ** 3 : -0.12 + 0.62 * z * (z + 0.9);
  const over = Math.min(Math.max((y - line) / 0.15, 0), 1);
  const grown = over * over * (3 - 2 * over);
  const volume = 1.07 + 0.05 * Math.max(0, y) + 0.02 * Math.max(0, -z);
  point.multiplyScalar(0.93 + (volume - 0.93) * grown);
}

function nose(point) {
  const { x, y, z } = point;
  const wide = y < 0 ? 1 : Math.max(0.45, 1 - 0.75 * y);
  point.set(0.0118 * x * wide, 0.022 * y, 0.0135 * z * (y > 0 ? 1 - 0.72 * y : 1) + (y < 0 ? 0.004 : 0.004 * (1 - y)));
}

function bow(places, side, radius) {
  const curve = new THREE.CatmullRomCurve3(places.map(([x, y, z]) => new THREE.Vector3(side * x, y, z)));
  const tube = new THREE.TubeGeometry(curve, 16, radius, 8);
  // Thin at both ends.
  const points = tube.attributes.position, point = new THREE.Vector3(), middle = new THREE.Vector3();
  for (let i = 0; i < points.count; i++) {
    const along = Math.floor(i / 9) / 16;
    curve.getPointAt(along, middle);
    point.fromBufferAttribute(points, i).sub(middle).multiplyScalar(0.25 + 0.75 * Math.sin(Math.PI * along) ** 0.7);
    points.setXYZ(i, middle.x + point.x, middle.y + point.y, middle.z + point.z);
  }
  tube.computeVertexNormals();
  return tube;
}
