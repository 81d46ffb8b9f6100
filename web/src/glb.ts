// The scene of a page as GLB with its named objects, as `drsplat export` writes it (docs/formats.md): splats of
// KHR_gaussian_splatting, objects as features of EXT_mesh_features with a table of EXT_structural_metadata.

import type { SceneObject } from "./protocol";
import { rowsOf, SH_C0 } from "./spz";
import type { Vec } from "./vectors";

const FLOAT = 5126, BYTE = 5121, SHORT = 5123, NOBODY = 65535, SPLAT = "KHR_gaussian_splatting:", TYPES = { 1: "SCALAR", 3: "VEC3", 4: "VEC4" } as const;
const EXTENSIONS = ["KHR_gaussian_splatting", "EXT_mesh_features", "EXT_structural_metadata"], MAGIC = 0x46546c67, JSON_CHUNK = 0x4e4f534a, BINARY_CHUNK = 0x004e4942;
type Numbers = Float32Array | Uint8Array | Uint16Array | Uint32Array | Int32Array;

export interface Contents { title: string; objects: SceneObject[]; numbers: Uint16Array | null; frame: { center: Vec; scale: number }; antialiased: boolean }

/** Write a decompressed SPZ and the objects of a page. numbers: of each row, 0 for none, k for objects[k - 1]. */
export function glbOf(buffer: ArrayBuffer, { title, objects, numbers, frame, antialiased }: Contents): Blob {
  const file = new Parts(), attributes = splats(file, buffer), ids = numbers && objects.length > 0;
  if (ids) attributes._FEATURE_ID_0 = file.accessor(padded(Uint16Array.from(numbers, (number) => number ? number - 1 : NOBODY)), 1, SHORT, numbers.length, 4);
  const features = { EXT_mesh_features: { featureIds: [{ featureCount: objects.length, nullFeatureId: NOBODY, attribute: 0, propertyTable: 0, label: "objects" }] } };
  const splatting = { kernel: "ellipse", colorSpace: "srgb_rec709_display", sortingMethod: "cameraDistance", projection: "perspective" };
  return file.written({
    asset: { version: "2.0", generator: "drsplat" }, extensionsUsed: ids ? EXTENSIONS : EXTENSIONS.slice(0, 1),
    ...(ids ? { extensions: { EXT_structural_metadata: table(file, objects, frame) } } : {}),
    scene: 0, scenes: [{ name: title, nodes: [0] }],
    nodes: [{ name: title, rotation: [1, 0, 0, 0], children: [1], extras: { drsplat: { frame: "world", ...(antialiased ? { antialiased } : {}) } } }, { name: "splats", mesh: 0 }],
    meshes: [{ name: title, primitives: [{ mode: 0, attributes, extensions: { KHR_gaussian_splatting: splatting, ...(ids ? features : {}) } }] }],
  });
}

function splats(file: Parts, buffer: ArrayBuffer): Record<string, number> {
  const { count, read } = rowsOf(buffer), floats = (width: number) => new Float32Array(width * count);
  const centers = floats(3), quats = floats(4), sizes = floats(3), opacities = floats(1), constants = floats(3), points = new Uint8Array(4 * count);
  const low: Vec = [Infinity, Infinity, Infinity], high: Vec = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < count; i++) {
    const { center, quat, size, sh, opacity } = read(i);
    centers.set(center, 3 * i), quats.set(quat, 4 * i), sizes.set(size, 3 * i), constants.set(sh, 3 * i);
    opacities[i] = opacity / 255;
    points.set([...sh.map((value) => Math.round(255 * linear(0.5 + SH_C0 * value))), opacity], 4 * i);
    for (let k = 0; k < 3; k++) low[k] = Math.min(low[k], centers[3 * i + k]), high[k] = Math.max(high[k], centers[3 * i + k]);
  }
  return {
    POSITION: file.accessor(centers, 3, FLOAT, count, 0, { min: low, max: high }), COLOR_0: file.accessor(points, 4, BYTE, count, 0, { normalized: true }),
    [`${SPLAT}ROTATION`]: file.accessor(quats, 4, FLOAT, count), [`${SPLAT}SCALE`]: file.accessor(sizes, 3, FLOAT, count),
    [`${SPLAT}OPACITY`]: file.accessor(opacities, 1, FLOAT, count), [`${SPLAT}SH_DEGREE_0_COEF_0`]: file.accessor(constants, 3, FLOAT, count),
  };
}

/** Return the table of objects; places and lengths are those of the scene's own file. */
function table(file: Parts, objects: SceneObject[], frame: { center: Vec; scale: number }): object {
  const texts = objects.map((thing) => new TextEncoder().encode(plainName(thing))), ends = [0], own = (x: number, k: number) => x / frame.scale + frame.center[k];
  texts.forEach((text) => ends.push(ends[ends.length - 1] + text.length));
  const bytes = new Uint8Array(Math.max(1, ends[ends.length - 1]));
  texts.forEach((text, k) => bytes.set(text, ends[k]));
  const floats = (numbers: (thing: SceneObject) => number[]) => ({ values: file.view(Float32Array.from(objects.flatMap(numbers))) });
  const real = { componentType: "FLOAT32", required: true }, whole = (componentType: string) => ({ type: "SCALAR", componentType, required: true });
  const properties = {
    name: { type: "STRING", required: true }, center: { type: "VEC3", ...real }, extent: { type: "VEC3", ...real }, axes: { type: "MAT3", ...real },
    number: whole("INT32"), num_gaussians: whole("UINT32"),
  };
  return {
    schema: { id: "drsplat", classes: { object: { properties } } },
    propertyTables: [{
      name: "objects", class: "object", count: objects.length, properties: {
        name: { values: file.view(bytes), stringOffsets: file.view(Uint32Array.from(ends)) },
        center: floats((thing) => thing.center.map(own)), extent: floats((thing) => thing.extent.map((x) => x / frame.scale)), axes: floats((thing) => thing.axes.flat()),
        number: { values: file.view(Int32Array.from(objects, (thing) => thing.number)) }, num_gaussians: { values: file.view(Uint32Array.from(objects, (thing) => thing.num_gaussians)) },
      },
    }],
  };
}

/** Return a name without the number that lists add to tell two mugs apart; the table has a column of numbers. */
function plainName({ name, number }: SceneObject): string {
  const added = ` · ${number}`;
  return name.endsWith(added) ? name.slice(0, -added.length) : name;
}

/** The binary chunk while it is laid out. */
class Parts {
  private readonly parts: Uint8Array<ArrayBuffer>[] = [];
  private readonly bufferViews: object[] = [];
  private readonly accessors: object[] = [];
  private size = 0;

  /** Append bytes at a multiple of eight; returns the number of their view. */
  view(values: Numbers, more: object = {}): number {
    const bytes = new Uint8Array(values.buffer as ArrayBuffer, values.byteOffset, values.byteLength), spare = -bytes.length & 7;
    this.bufferViews.push({ buffer: 0, byteOffset: this.size, byteLength: bytes.length, ...more });
    this.parts.push(bytes, new Uint8Array(spare));
    this.size += bytes.length + spare;
    return this.bufferViews.length - 1;
  }

  /** Append one value of `width` numbers per Gaussian; returns the number of their accessor. */
  accessor(values: Numbers, width: keyof typeof TYPES, componentType: number, count: number, byteStride = 0, more: object = {}): number {
    const bufferView = this.view(values, { target: 34962, ...(byteStride ? { byteStride } : {}) });
    this.accessors.push({ bufferView, componentType, count, type: TYPES[width], ...more });
    return this.accessors.length - 1;
  }

  written(document: object): Blob {
    const text = new TextEncoder().encode(JSON.stringify({ ...document, accessors: this.accessors, bufferViews: this.bufferViews, buffers: [{ byteLength: this.size }] }));
    const spaces = new TextEncoder().encode(" ".repeat(-(text.length + 28) & 7)), length = text.length + spaces.length;
    const head = Uint32Array.of(MAGIC, 2, 28 + length + this.size, length, JSON_CHUNK), binary = Uint32Array.of(this.size, BINARY_CHUNK);
    return new Blob([head, text, spaces, binary, ...this.parts], { type: "model/gltf-binary" });
  }
}

/** Return short numbers at every fourth byte, as attributes of points have to be. */
function padded(numbers: Uint16Array): Uint16Array {
  const wide = new Uint16Array(2 * numbers.length);
  numbers.forEach((number, i) => { wide[2 * i] = number; });
  return wide;
}

/** Return a shown colour as the light that glTF has at points. */
function linear(shown: number): number {
  const x = Math.min(1, Math.max(0, shown));
  return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
}
