// Gaussians drawn by a graphics card.

import type { Pose } from "../camera";
import type { Splats } from "../protocol";
import type { Marks } from "./raster";
import { EDGE_FRAGMENT, SCREEN_VERTEX, SPLAT_FRAGMENT, SPLAT_VERTEX } from "./shaders";

const ACROSS = 1024; // Gaussians in a row of a texture

/** Return whether a context is drawn by a processor: a card's programs are then slower than ours. */
export function isSoftware(gl: WebGL2RenderingContext): boolean {
  const names = gl.getExtension("WEBGL_debug_renderer_info"), renderer = names ? String(gl.getParameter(names.UNMASKED_RENDERER_WEBGL)) : String(gl.getParameter(gl.RENDERER));
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
}

export class Card {
  private readonly splat: WebGLProgram;
  private readonly edge: WebGLProgram;
  private readonly rows: WebGLBuffer;
  private readonly marked: WebGLBuffer;
  private readonly cover: WebGLTexture;
  private readonly target: WebGLFramebuffer;
  private readonly arrays: WebGLVertexArrayObject[];
  private words = new Uint32Array(0);
  private number = 0;
  private marks: { begin: number; count: number; color: number[] }[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.splat = program(gl, SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.edge = program(gl, SCREEN_VERTEX, EDGE_FRAGMENT);
    this.rows = gl.createBuffer();
    this.marked = gl.createBuffer();
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    this.arrays = [this.rows, this.marked].map((buffer) => this.array(corners, buffer));
    this.cover = [0, 1, 2].map((unit) => texture(gl, unit, unit === 2))[2]; // shapes, colours, cover of marks
    this.target = gl.createFramebuffer();
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  private array(corners: WebGLBuffer, rows: WebGLBuffer): WebGLVertexArrayObject {
    const gl = this.gl, made = gl.createVertexArray();
    gl.bindVertexArray(made);
    const corner = gl.getAttribLocation(this.splat, "corner"), row = gl.getAttribLocation(this.splat, "row");
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, rows);
    gl.enableVertexAttribArray(row);
    gl.vertexAttribIPointer(row, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(row, 1);
    return made;
  }

  /** Return how many Gaussians fit. */
  get room(): number { return ACROSS * this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE); }

  load(splats: Splats): void {
    const gl = this.gl, lines = Math.max(1, Math.ceil(splats.count / ACROSS));
    this.words = new Uint32Array(ACROSS * lines * 8);
    this.pack(splats, splats.count);
    gl.activeTexture(gl.TEXTURE0);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, 2 * ACROSS, lines, 0, gl.RGBA_INTEGER, gl.UNSIGNED_INT, this.words);
  }

  /** Take other places and covariances of the first rows. */
  move(splats: Splats, upto: number): void {
    const gl = this.gl, lines = Math.ceil(upto / ACROSS);
    this.pack(splats, upto);
    gl.activeTexture(gl.TEXTURE0);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 2 * ACROSS, lines, gl.RGBA_INTEGER, gl.UNSIGNED_INT, this.words.subarray(0, 8 * ACROSS * lines));
  }

  private pack({ centers, covariances: c }: Splats, upto: number): void {
    const bits = new Uint32Array(centers.buffer, centers.byteOffset, centers.length), words = this.words;
    for (let i = 0; i < upto; i++) {
      const to = 8 * i, from = 6 * i;
      for (let k = 0; k < 3; k++) {
        words[to + k] = bits[3 * i + k];
        words[to + 4 + k] = c[from + 2 * k] | (c[from + 2 * k + 1] << 16);
      }
    }
  }

  recolor(rgba: Uint8Array): void {
    const gl = this.gl, lines = Math.max(1, Math.ceil(rgba.length / 4 / ACROSS)), padded = new Uint8Array(4 * ACROSS * lines);
    padded.set(rgba);
    gl.activeTexture(gl.TEXTURE1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, ACROSS, lines, 0, gl.RGBA, gl.UNSIGNED_BYTE, padded);
  }

  order(rows: Uint32Array): void {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rows);
    gl.bufferData(gl.ARRAY_BUFFER, rows, gl.DYNAMIC_DRAW);
    this.number = rows.length;
  }

  mark(marks: Marks[]): void {
    const gl = this.gl, all = new Uint32Array(marks.reduce((sum, one) => sum + one.rows.length, 0));
    let begin = 0;
    this.marks = marks.map(({ rows, color }) => {
      all.set(rows, begin);
      begin += rows.length;
      return { begin: begin - rows.length, count: rows.length, color };
    });
    gl.bindBuffer(gl.ARRAY_BUFFER, this.marked);
    gl.bufferData(gl.ARRAY_BUFFER, all, gl.STATIC_DRAW);
  }

  draw(pose: Pose, ratio: number, background: number[], antialiased: boolean): void {
    const gl = this.gl, { canvas } = gl, [r, g, b] = background;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(r, g, b, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    this.look(pose, ratio, antialiased, canvas.width, canvas.height);
    gl.bindVertexArray(this.arrays[0]);
    gl.uniform4f(this.of(this.splat, "flat_color"), 0, 0, 0, 0);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.number);
    if (this.marks.length) this.outline(pose, ratio, antialiased);
  }

  private look(pose: Pose, ratio: number, antialiased: boolean, width: number, height: number): void {
    const gl = this.gl, { right, down, ahead } = pose;
    gl.useProgram(this.splat);
    gl.uniform1i(this.of(this.splat, "shape"), 0);
    gl.uniform1i(this.of(this.splat, "paint"), 1);
    gl.uniform3f(this.of(this.splat, "eye"), ...pose.eye);
    gl.uniformMatrix3fv(this.of(this.splat, "world_to_camera"), false, [0, 1, 2].flatMap((k) => [right[k], down[k], ahead[k]]));
    gl.uniform1f(this.of(this.splat, "focal"), pose.focal * ratio);
    gl.uniform2f(this.of(this.splat, "viewport"), width, height);
    gl.uniform1i(this.of(this.splat, "antialiased"), Number(antialiased));
  }

  private outline(pose: Pose, ratio: number, antialiased: boolean): void {
    const gl = this.gl, { canvas } = gl, width = Math.max(1, canvas.width >> 1), height = Math.max(1, canvas.height >> 1);
    gl.activeTexture(gl.TEXTURE2);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.cover, 0);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    this.look(pose, ratio / 2, antialiased, width, height);
    gl.bindVertexArray(this.arrays[1]);
    const row = gl.getAttribLocation(this.splat, "row");
    for (const { begin, count, color } of this.marks) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.marked);
      gl.vertexAttribIPointer(row, 1, gl.UNSIGNED_INT, 0, 4 * begin);
      gl.uniform4f(this.of(this.splat, "flat_color"), color[0], color[1], color[2], 1);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.useProgram(this.edge);
    gl.uniform1i(this.of(this.edge, "cover"), 2);
    gl.uniform2f(this.of(this.edge, "step_"), (1.6 * ratio) / canvas.width, (1.6 * ratio) / canvas.height);
    gl.bindVertexArray(this.arrays[0]);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  private of(made: WebGLProgram, name: string): WebGLUniformLocation | null { return this.gl.getUniformLocation(made, name); }
}

function program(gl: WebGL2RenderingContext, vertex: string, fragment: string): WebGLProgram {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]] as const) {
    const shader = gl.createShader(kind);
    if (!shader) throw new Error("the graphics card makes no shader");
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "a shader does not compile");
    gl.attachShader(made, shader);
  }
  gl.bindAttribLocation(made, 0, "corner");
  gl.linkProgram(made);
  return made;
}

function texture(gl: WebGL2RenderingContext, unit: number, smooth: boolean): WebGLTexture {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, smooth ? gl.LINEAR : gl.NEAREST);
  for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
  return made;
}
