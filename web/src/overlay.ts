// Names over the picture, none of them over another, and notes that people left.

import type { Pose, Camera } from "./camera";
import type { Annotation, Color, State } from "./protocol";
import type { Vec } from "./vectors";

const NOTE: Color = [255, 224, 130], MOST_NAMES = 12, HEIGHT = 24, GAP = 4;

interface Label { x: number; y: number; text: string; color: Color; point: boolean }

export class Overlay {
  visible = true;

  constructor(private readonly canvas: HTMLCanvasElement, private readonly camera: Camera) {}

  draw(pose: Pose, state: State): void {
    const ratio = Math.min(2, devicePixelRatio || 1), [w, h] = [Math.round(pose.width * ratio), Math.round(pose.height * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    const pen = this.canvas.getContext("2d");
    if (!pen) return;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, pose.width, pose.height);
    if (!this.visible) return;
    const labels = [...this.matches(pose, state), ...state.annotations.flatMap((note) => this.note(pose, note))];
    place(pen, labels, pose);
  }

  private matches(pose: Pose, state: State): Label[] {
    if (!["answer", "heat map", "objects"].includes(state.mode)) return [];
    return state.results.flatMap((result) => {
      const several = result.matches.length > 1;
      return result.matches.slice(0, MOST_NAMES).flatMap((match, number) => {
        if (match.gone) return [];
        const top = this.top(pose, match);
        return top ? [{ x: top[0], y: top[1], text: several ? `${number + 1}  ${match.name || result.text}` : match.name || result.text, color: result.accent, point: false }] : [];
      });
    });
  }

  /** Return the highest pixel of a box; null where a corner is behind the camera. */
  private top(pose: Pose, box: { center: Vec; axes: [Vec, Vec, Vec]; extent: Vec }): Vec | null {
    let best: Vec | null = null;
    for (let k = 0; k < 8; k++) {
      const corner = box.axes.reduce<Vec>((p, axis, a) => [0, 1, 2].map((c) => p[c] + ((k >> a) & 1 ? 0.5 : -0.5) * box.extent[a] * axis[c]) as Vec, box.center);
      const seen = this.camera.project(corner, pose);
      if (seen[2] < 0.05) return null;
      if (!best || seen[1] < best[1]) best = seen;
    }
    const middle = this.camera.project(box.center, pose);
    return best && [middle[0], best[1], middle[2]];
  }

  private note(pose: Pose, note: Annotation): Label[] {
    const { axes, extent } = note, at = axes && extent ? this.top(pose, { center: note.center, axes, extent }) : this.camera.project(note.center, pose);
    return at && at[2] > 0.05 ? [{ x: at[0], y: at[1], text: note.text, color: NOTE, point: !extent }] : [];
  }
}

/** Draw labels, each moved up until it is over none of those before it. */
function place(pen: CanvasRenderingContext2D, labels: Label[], pose: Pose): void {
  const taken: { x: number; y: number; wide: number }[] = [];
  pen.font = "600 12px system-ui, sans-serif";
  pen.textBaseline = "middle";
  for (const { x, y, text, color, point } of labels) {
    if (x < -60 || y < -60 || x > pose.width + 60 || y > pose.height + 60) continue;
    const short = text.length > 40 ? `${text.slice(0, 39)}…` : text, wide = pen.measureText(short).width + 27;
    const left = Math.min(Math.max(x - wide / 2, 4), pose.width - wide - 4);
    let top = Math.max(4, y - HEIGHT - 10);
    const meets = (other: { x: number; y: number; wide: number }) => left < other.x + other.wide + GAP && other.x < left + wide + GAP && Math.abs(other.y - top) < HEIGHT + GAP;
    for (let tries = 0, other; tries < 12 && (other = taken.find(meets)); tries++) top = other.y - HEIGHT - GAP - 1;
    taken.push({ x: left, y: top, wide });
    const css = `rgb(${color.join(",")})`;
    pen.strokeStyle = css;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(x, top + HEIGHT);
    pen.lineTo(x, y);
    pen.stroke();
    if (point) { pen.fillStyle = css; pen.beginPath(); pen.arc(x, y, 4, 0, 7); pen.fill(); }
    pen.fillStyle = "rgba(18,20,25,.88)";
    pen.beginPath();
    pen.roundRect(left, top, wide, HEIGHT, 7);
    pen.fill();
    pen.fillStyle = css;
    pen.fillRect(left + 7, top + HEIGHT / 2 - 3, 6, 6);
    pen.fillStyle = "#f2f4f8";
    pen.fillText(short, left + 18, top + HEIGHT / 2 + 0.5, wide - 24);
  }
}
