// A camera around a target, never upside down, and its flights.

import { clamp, cross, dot, minus, mix, norm, plane, plus, times, unit, type Vec } from "./vectors";

const FLIGHT_MS = 700, STEEPEST = 1.45, NEAREST = 0.05;

/** One picture's camera: its place, its axes in the scene, its focal length in CSS pixels. */
export interface Pose { eye: Vec; right: Vec; down: Vec; ahead: Vec; focal: number; width: number; height: number }

type Step = (now: number) => boolean;

export class Camera {
  target: Vec = [0, 0, 0];
  yaw = 0;
  pitch = 0;
  distance = 1;
  width = 1;
  height = 1;
  private step: Step | null = null;
  private stopped: (() => void) | null = null;
  private readonly east: Vec;
  private readonly north: Vec;

  constructor(readonly up: Vec, public fov: number, readonly changed: () => void) {
    [this.east, this.north] = plane(up);
  }

  get isFlying(): boolean { return this.step !== null; }

  get eye(): Vec { return plus(this.target, this.back(), this.distance); }

  private back(): Vec {
    const flat = plus(times(this.east, Math.cos(this.yaw)), this.north, Math.sin(this.yaw));
    return plus(times(flat, Math.cos(this.pitch)), this.up, Math.sin(this.pitch));
  }

  pose(): Pose {
    const back = this.back(), ahead = times(back, -1), right = unit(cross(ahead, this.up));
    const focal = this.height / (2 * Math.tan((this.fov * Math.PI) / 360));
    const eye = plus(this.target, back, this.distance);
    return { eye, right, down: cross(ahead, right), ahead, focal, width: this.width, height: this.height };
  }

  /** Stand at a place; what flies goes on. */
  stand(eye: Vec, target: Vec): void {
    Object.assign(this, this.polar(eye, target));
    this.changed();
  }

  private polar(eye: Vec, target: Vec): { target: Vec; distance: number; pitch: number; yaw: number } {
    const back = minus(eye, target), distance = norm(back) || 1, height = dot(back, this.up) / distance;
    const pitch = Math.asin(clamp(height, -0.99, 0.99));
    return { target: [...target], distance, pitch, yaw: Math.atan2(dot(back, this.north), dot(back, this.east)) };
  }

  turn(yaw: number, pitch: number): void {
    this.yaw += yaw;
    this.pitch = clamp(this.pitch + pitch, -STEEPEST, STEEPEST);
    this.changed();
  }

  /** Shift by pixels of the picture, at the target's distance. */
  shift(dx: number, dy: number): void {
    const { right, down, focal } = this.pose(), step = this.distance / focal;
    this.target = plus(plus(this.target, right, -dx * step), down, -dy * step);
    this.changed();
  }

  nearer(factor: number): void {
    this.distance = Math.max(NEAREST, this.distance * factor);
    this.changed();
  }

  walk(direction: Vec, step: number): void {
    this.target = plus(this.target, direction, step);
    this.changed();
  }

  /** Take a step before each picture until one says that it was the last; `null` stops. */
  fly(step: Step | null, stopped: (() => void) | null = null): void {
    const interrupted = this.stopped;
    this.step = this.stopped = null;
    interrupted?.();
    this.step = step;
    this.stopped = stopped;
    this.changed();
  }

  flyTo(eye: Vec, target: Vec): void {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) { this.fly(null); this.stand(eye, target); return; }
    const from = { target: this.target, distance: this.distance, pitch: this.pitch, yaw: this.yaw };
    const to = this.polar(eye, target), begin = performance.now();
    to.yaw = from.yaw + Math.atan2(Math.sin(to.yaw - from.yaw), Math.cos(to.yaw - from.yaw));
    this.fly((now) => {
      const t = clamp((now - begin) / FLIGHT_MS, 0, 1), s = t * t * (3 - 2 * t), blend = (a: number, b: number) => a + (b - a) * s;
      this.target = mix(from.target, to.target, s);
      this.distance = blend(from.distance, to.distance);
      this.pitch = blend(from.pitch, to.pitch);
      this.yaw = blend(from.yaw, to.yaw);
      return t >= 1;
    });
  }

  /** Go on with what flies, at the time of a picture. */
  advance(now: number): void {
    if (this.step && this.step(now)) this.step = this.stopped = null;
  }

  /** Return the pixel (CSS, from the left and top) and the depth of a place. */
  project(point: Vec, pose = this.pose()): Vec {
    const p = minus(point, pose.eye), z = dot(p, pose.ahead);
    const x = pose.width / 2 + (pose.focal * dot(p, pose.right)) / z;
    return [x, pose.height / 2 + (pose.focal * dot(p, pose.down)) / z, z];
  }

  /** Return the unit direction that a pixel looks in. */
  ray(x: number, y: number): Vec {
    const { ahead, right, down, focal, width, height } = this.pose();
    return unit(plus(plus(ahead, right, (x - width / 2) / focal), down, (y - height / 2) / focal));
  }
}
