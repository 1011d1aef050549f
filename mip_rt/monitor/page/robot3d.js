// The robot on its floor, drawn by our own projection on a 2-D canvas: parts are convex, so hiding faces that look away and drawing the
// farthest part first is enough.

import { colour, Drawing } from "./canvas.js";
import { add, attitude, cross, dot, product, rotation, scale, subtract, turn, unit } from "./geometry.js";
import { shapeOf, wheelParts } from "./shapes.js";

const LIGHT = unit([-0.45, 0.35, 0.85]);
const BEHIND = { azimuth: Math.PI + 0.35, elevation: 0.36, distance: 0.62 };
const TRAIL = 900;
const GRID_M = 0.1;

export class RobotView {
  constructor(canvas) {
    this.drawing = new Drawing(canvas, (context, width, height) => this.paint(context, width, height));
    this.camera = { ...BEHIND };
    this.forget();
    this.dragWithPointer(canvas);
  }

  /** A new run: its shape, and nothing known yet. */
  start(run) {
    this.shape = shapeOf(run);
    this.forget();
  }

  forget() {
    this.ball = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    this.ballAngle = this.view = null;
    this.position = [0, 0];
    this.centre = null;
    this.trail = [];
  }

  /** The newest pose. */
  show(view) {
    const angle = view.ball_angle_rad;
    if (angle && angle[0] !== null && angle[1] !== null) {
      if (this.ballAngle) this.ball = product(rotation([angle[0] - this.ballAngle[0], angle[1] - this.ballAngle[1], 0]), this.ball);
      this.ballAngle = angle;
    }
    const position = view.position_m;
    if (position && position[0] !== null && position[1] !== null) {
      this.position = position;
      const last = this.trail.at(-1);
      if (!last || Math.hypot(last[0] - position[0], last[1] - position[1]) > 0.004) this.trail.push(position);
      if (this.trail.length > TRAIL) this.trail.shift();
    }
    // The camera follows slowly, so that small motions remain visible.
    this.centre ??= this.position.slice();
    this.centre = this.centre.map((c, i) => c + 0.06 * (this.position[i] - c));
    this.view = view;
    this.drawing.request();
  }

  /** Moves the camera: left, right, in, out, top, reset. */
  move(how) {
    const camera = this.camera;
    if (how === "left") camera.azimuth += 0.26;
    if (how === "right") camera.azimuth -= 0.26;
    if (how === "in") camera.distance = Math.max(0.3, camera.distance / 1.2);
    if (how === "out") camera.distance = Math.min(3, camera.distance * 1.2);
    if (how === "top") camera.elevation = 1.5;
    if (how === "reset") Object.assign(camera, BEHIND);
    this.drawing.request();
  }

  dragWithPointer(canvas) {
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this.camera.azimuth -= event.movementX * 0.01;
      this.camera.elevation = Math.min(1.5, Math.max(0.03, this.camera.elevation + event.movementY * 0.008));
      this.drawing.request();
    });
  }

  paint(context, width, height) {
    if (!this.shape) return;
    const { azimuth, elevation, distance } = this.camera;
    const target = [...(this.centre ?? [0, 0]), 0.075];
    const away = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
    this.eye = add(target, scale(away, distance));
    const forward = scale(away, -1), right = unit(cross(forward, [0, 0, 1])), up = cross(right, forward);
    const focal = 1.5 * Math.min(height, width * 0.8);
    this.project = (point) => {
      const p = subtract(point, this.eye), depth = dot(p, forward);
      return depth > 0.02 ? [width / 2 + (focal * dot(p, right)) / depth, height / 2 - (focal * dot(p, up)) / depth] : null;
    };
    this.paintFloor(context);
    this.paintRobot(context);
    this.paintCompass(context, width, height, right, up);
  }

  path(context, points, close = true) {
    const projected = points.map(this.project);
    if (projected.includes(null)) return false;
    context.beginPath();
    projected.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    if (close) context.closePath();
    return true;
  }

  paintFloor(context) {
    const [cx, cy] = (this.centre ?? [0, 0]).map((c) => Math.round(c / GRID_M) * GRID_M);
    const reach = 12;
    for (let i = -reach; i <= reach; i++) {
      for (const along of [0, 1]) {
        // In pieces, so that lines that pass the eye are drawn as far as they are in front of it, and fade with distance.
        for (let j = -reach; j < reach; j++) {
          const ends = [j, j + 1].map((k) => (along ? [cx + k * GRID_M, cy + i * GRID_M, 0] : [cx + i * GRID_M, cy + k * GRID_M, 0]));
          const fade = 1 - Math.hypot(i, j + 0.5) / reach;
          if (fade <= 0 || !this.path(context, ends, false)) continue;
          const coordinate = Math.round((along ? ends[0][1] : ends[0][0]) / GRID_M);
          context.strokeStyle = colour("floor-line");
          context.globalAlpha = fade;
          context.lineWidth = coordinate % 5 ? 1 : 2.2;
          context.stroke();
        }
      }
    }
    context.globalAlpha = 1;
    if (this.trail.length > 1) {
      context.strokeStyle = colour("trail");
      context.lineWidth = 2.5;
      context.lineJoin = "round";
      if (this.path(context, this.trail.map(([x, y]) => [x, y, 0.001]), false)) context.stroke();
    }
    const [x, y] = this.position;
    const round = Array.from({ length: 28 }, (_, i) => [
      x + this.shape.shadow * Math.cos((i * Math.PI) / 14), y + this.shape.shadow * Math.sin((i * Math.PI) / 14), 0.0005]);
    context.fillStyle = colour("shadow");
    if (this.path(context, round)) context.fill();
  }

  // The remote's "forward" is the floor's x, whatever the robot's heading: a compass in the corner says which way that is.
  paintCompass(context, width, height, right, up) {
    const length = 34, middle = [width - 100, height - 44];
    context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineWidth = 2;
    context.lineCap = "round";
    for (const [axis, label, paint] of [[[1, 0, 0], "forward x", "front"], [[0, 1, 0], "left y", "fine"]]) {
      const [dx, dy] = [dot(axis, right), -dot(axis, up)];
      const tip = [middle[0] + length * dx, middle[1] + length * dy];
      const back = Math.atan2(tip[1] - middle[1], tip[0] - middle[0]) + Math.PI;
      context.strokeStyle = context.fillStyle = colour(paint);
      context.beginPath();
      context.moveTo(...middle);
      context.lineTo(...tip);
      for (const side of [-0.5, 0.5]) {
        context.moveTo(...tip);
        context.lineTo(tip[0] + 8 * Math.cos(back + side), tip[1] + 8 * Math.sin(back + side));
      }
      context.stroke();
      context.textAlign = dx < -0.3 ? "right" : dx > 0.3 ? "left" : "center";
      context.fillText(label, tip[0] + 8 * Math.sign(Math.round(2 * dx)), tip[1] + (Math.abs(dx) > 0.3 ? 0 : dy > 0 ? 11 : -11));
    }
  }

  paintRobot(context) {
    const [roll, pitch, yaw] = (this.view?.attitude_rad ?? []).map((angle) => angle ?? 0);
    const body = attitude(roll ?? 0, pitch ?? 0, yaw ?? 0);
    const origin = [...this.position, this.shape.height];
    const angles = this.view?.wheel_angle_rad ?? [];
    const parts = [...this.shape.parts, ...this.shape.wheels.flatMap((wheel, i) => wheelParts(wheel, angles[i]))];
    const placed = parts.map((part) => {
      const turned = part.frame === "ball" ? this.ball : body;
      const faces = part.faces.map((face) => face.map((point) => add(turn(turned, point), origin)));
      const points = faces.flat();
      const middle = scale(points.reduce(add, [0, 0, 0]), 1 / points.length);
      return { faces, paint: part.paint, depth: Math.hypot(...subtract(middle, this.eye)) };
    });
    placed.sort((a, b) => b.depth - a.depth);
    for (const { faces, paint } of placed) {
      for (const face of faces) this.paintFace(context, face, paint);
    }
  }

  paintFace(context, face, paint) {
    const normal = unit(cross(subtract(face[2], face[0]), subtract(face.at(-1), face[1]))); // diagonals: right at a sphere's poles, too
    if (dot(normal, subtract(this.eye, face[0])) <= 0 || !this.path(context, face)) return;
    context.fillStyle = colour(paint);
    context.strokeStyle = context.fillStyle; // closes the seams between faces
    context.lineWidth = 0.7;
    context.fill();
    context.stroke();
    const shade = 0.5 - 0.5 * dot(normal, LIGHT);
    context.fillStyle = `rgb(8 14 24 / ${(shade * 0.62).toFixed(3)})`;
    context.fill();
  }
}
