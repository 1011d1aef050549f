// What the robots look like. A part is convex: {faces, paint}, faces in the frame that `frame` names: "body", "ball" or "world".
// The sizes that the configuration knows come from it; the rest is a drawing.

import { add, box, prism, scale, sphere, unit } from "./geometry.js";

const CONTACT_RAD = Math.PI / 4; // of the wheels from the ball's top; the configuration has their axes only

/** The ball-balancing robot; the body's origin is the ball's centre. */
function mbbr(run) {
  const radius = run.ball_radius_m, wheel = run.wheel_radius_m;
  const ball = sphere(radius, 24, 12).map(({ points, i, j }) => ({
    frame: "ball", faces: [points], paint: (i >> 2) % 2 === (j >= 6 ? 1 : 0) ? "ball-a" : "ball-b",
  }));
  const wheels = [0, 1, 2].map((k) => {
    const axis = unit(run.body_from_wheel.map((row) => row[k]));
    const azimuth = Math.atan2(axis[1], axis[0]) + 0.75 * Math.PI;
    const contact = [Math.sin(CONTACT_RAD) * Math.cos(azimuth), Math.sin(CONTACT_RAD) * Math.sin(azimuth), Math.cos(CONTACT_RAD)];
    return { axis, centre: scale(contact, radius + wheel), radius: wheel, width: 0.0105 };
  });
  const body = [
    ...[0, 1, 2].map((k) => prism([0, 0, 0], [0, 0, 1], 0.005, 0.066, 0.150, 8).map((face) => face.map((point) =>
      add(point, [0.04 * Math.cos((2 * Math.PI * k) / 3 + 0.5), 0.04 * Math.sin((2 * Math.PI * k) / 3 + 0.5), 0])))).map((faces) => part(faces, "body")),
    part(prism([0, 0, 0], [0, 0, 1], 0.052, 0.060, 0.066, 24), "plate"),
    part(prism([0, 0, 0], [0, 0, 1], 0.052, 0.106, 0.111, 24), "plate"),
    part(box([-0.034, -0.018, 0.067], [0.034, 0.018, 0.092]), "wheel"),
    part(box([-0.034, -0.024, 0.112], [0.034, 0.024, 0.124]), "body"),
    part(prism([0, 0, 0], [0, 0, 1], 0.052, 0.150, 0.156, 24), "plate"),
    part(box([0.030, -0.006, 0.1565], [0.050, 0.006, 0.160]), "front"),
  ];
  return { height: radius, parts: [...ball, ...body], wheels, shadow: 0.055 };
}

/** A robot on two wheels; the body's origin is the middle of the axle. */
function mip(run) {
  const radius = run.wheel_radius_m || 0.034, half = (run.track_m || 0.07) / 2;
  const wheels = [-1, 1].map((side) => ({ axis: [0, 1, 0], centre: [0, (half + 0.005) * side, 0], radius, width: 0.018 })); // right, left
  const body = [
    part(box([-0.016, -0.028, -0.010], [0.016, 0.028, 0.110]), "body"),
    part(box([-0.020, -0.030, 0.110], [0.020, 0.030, 0.118]), "plate"),
    part(box([0.0161, -0.020, 0.020], [0.019, 0.020, 0.090]), "front"),
  ];
  return { height: radius, parts: body, wheels, shadow: 0.045 };
}

function part(faces, paint) {
  return { frame: "body", faces, paint };
}

/** The two discs of a wheel that has turned by `angle`: a drum, and a mark that shows the turning. */
export function wheelParts(wheel, angle) {
  const half = wheel.width / 2;
  const drum = part(prism(wheel.centre, wheel.axis, wheel.radius, -half, half, 24, angle || 0), "wheel");
  const hub = [-1, 1].map((side) => part(prism(wheel.centre, wheel.axis, wheel.radius * 0.62, side * half * 1.02, side * half * 1.12, 3, angle || 0)
    .map((face) => (side < 0 ? face.slice().reverse() : face)), "ball-b"));
  return [drum, ...hub];
}

/** The shape of a run's robot. */
export function shapeOf(run) {
  return run.ball_radius_m && run.body_from_wheel?.[0]?.length === 3 ? mbbr(run) : mip(run);
}
