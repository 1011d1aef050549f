// Vectors and rotations as arrays; world axes x forward, y left, z up, metres and radians.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const unit = (a) => scale(a, 1 / (Math.hypot(...a) || 1));

/** Matrix (rows) times vector. */
export const turn = (m, v) => [dot(m[0], v), dot(m[1], v), dot(m[2], v)];

/** Matrix times matrix. */
export function product(a, b) {
  const columns = [0, 1, 2].map((j) => [b[0][j], b[1][j], b[2][j]]);
  return a.map((row) => columns.map((column) => dot(row, column)));
}

/** Rz(yaw) Ry(pitch) Rx(roll): body to world. */
export function attitude(roll, pitch, yaw) {
  const [cr, sr, cp, sp, cy, sy] = [Math.cos(roll), Math.sin(roll), Math.cos(pitch), Math.sin(pitch), Math.cos(yaw), Math.sin(yaw)];
  return [
    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
    [-sp, cp * sr, cp * cr],
  ];
}

/** Rotation by a vector: its length is the angle, its direction the axis. */
export function rotation(vector) {
  const angle = Math.hypot(...vector);
  if (angle < 1e-12) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const [x, y, z] = scale(vector, 1 / angle);
  const c = Math.cos(angle), s = Math.sin(angle), k = 1 - c;
  return [
    [c + x * x * k, x * y * k - z * s, x * z * k + y * s],
    [y * x * k + z * s, c + y * y * k, y * z * k - x * s],
    [z * x * k - y * s, z * y * k + x * s, c + z * z * k],
  ];
}

/** A convex prism around an axis: `corners` sides, from `low` to `high` along `axis` through `centre`. Faces are lists of points. */
export function prism(centre, axis, radius, low, high, corners, phase = 0) {
  const along = unit(axis);
  const first = unit(Math.abs(along[2]) < 0.9 ? cross([0, 0, 1], along) : cross([1, 0, 0], along));
  const second = cross(along, first);
  const ring = (height) => Array.from({ length: corners }, (_, i) => {
    const angle = phase + (2 * Math.PI * i) / corners;
    return add(add(centre, scale(along, height)), add(scale(first, radius * Math.cos(angle)), scale(second, radius * Math.sin(angle))));
  });
  const bottom = ring(low), top = ring(high);
  const sides = bottom.map((point, i) => [point, bottom[(i + 1) % corners], top[(i + 1) % corners], top[i]]);
  return [...sides, top, bottom.slice().reverse()];
}

/** A box from one corner to the opposite. */
export function box([x0, y0, z0], [x1, y1, z1]) {
  const p = (i, j, k) => [i ? x1 : x0, j ? y1 : y0, k ? z1 : z0];
  return [
    [p(0, 0, 0), p(0, 1, 0), p(1, 1, 0), p(1, 0, 0)], [p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1)],
    [p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1)], [p(0, 1, 0), p(0, 1, 1), p(1, 1, 1), p(1, 1, 0)],
    [p(0, 0, 0), p(0, 0, 1), p(0, 1, 1), p(0, 1, 0)], [p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1)],
  ];
}

/** A sphere as quadrilaterals; each face comes with its longitude and latitude numbers. */
export function sphere(radius, sectors, rings) {
  const point = (i, j) => {
    const longitude = (2 * Math.PI * i) / sectors, latitude = Math.PI * (j / rings - 0.5);
    return scale([Math.cos(latitude) * Math.cos(longitude), Math.cos(latitude) * Math.sin(longitude), Math.sin(latitude)], radius);
  };
  const faces = [];
  for (let i = 0; i < sectors; i++) {
    for (let j = 0; j < rings; j++) faces.push({ points: [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)], i, j });
  }
  return faces;
}
