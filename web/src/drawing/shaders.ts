// Programs of the graphics card.

/** A square around each Gaussian, as far as it can be seen. */
export const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D shape;
uniform sampler2D paint;
uniform vec3 eye;
uniform mat3 world_to_camera;
uniform float focal;
uniform vec2 viewport;
uniform bool antialiased;
in vec2 corner;
in uint row;
out vec4 color;
out vec2 at;
void main() {
  ivec2 place = ivec2(int(row) % 1024, int(row) / 1024);
  uvec4 spread = texelFetch(shape, ivec2(2 * place.x + 1, place.y), 0);
  vec3 p = world_to_camera * (uintBitsToFloat(texelFetch(shape, ivec2(2 * place.x, place.y), 0).xyz) - eye);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  color = texelFetch(paint, place, 0);
  at = vec2(0.0);
  if (p.z < 0.05 || color.a < 0.004) return;
  vec2 a = unpackHalf2x16(spread.x), b = unpackHalf2x16(spread.y), c = unpackHalf2x16(spread.z);
  mat3 world = mat3(a.x, a.y, b.x, a.y, b.y, c.x, b.x, c.x, c.y);
  mat3 S = world_to_camera * world * transpose(world_to_camera);
  vec2 lens = 0.65 * viewport / focal, ray = clamp(p.xy / p.z, -lens, lens);
  vec3 jx = vec3(focal / p.z, 0.0, -focal * ray.x / p.z), jy = vec3(0.0, focal / p.z, -focal * ray.y / p.z);
  float xx = dot(jx, S * jx), yy = dot(jy, S * jy), xy = dot(jx, S * jy), sharp = xx * yy - xy * xy;
  xx += 0.3;
  yy += 0.3;
  if (antialiased) color.a *= sqrt(clamp(sharp / (xx * yy - xy * xy), 0.0, 1.0));
  if (color.a < 0.004) return;
  float reach = min(3.0, sqrt(2.0 * log(color.a * 255.0)));  // where it is too faint to be seen
  float middle = 0.5 * (xx + yy), apart = length(vec2(0.5 * (xx - yy), xy));
  float large = middle + apart, small = max(middle - apart, 0.1);
  vec2 axis = abs(xy) < 1e-6 ? (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0)) : normalize(vec2(xy, large - xx));
  vec2 offset = reach * (corner.x * min(sqrt(large), 512.0) * axis + corner.y * min(sqrt(small), 512.0) * vec2(-axis.y, axis.x));
  vec2 pixel = focal * p.xy / p.z;
  if (any(greaterThan(abs(pixel), 1.3 * 0.5 * viewport + 512.0))) return;
  at = reach * corner;
  gl_Position = vec4(2.0 * (pixel + offset) / viewport * vec2(1.0, -1.0), 0.0, 1.0);
}`;

export const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec4 color;
in vec2 at;
out vec4 pixel;
uniform vec4 flat_color;  // of a mark; its last number is 0 where colours are the splats' own
void main() {
  float far = dot(at, at);
  if (far > 9.0) discard;
  float alpha = color.a * exp(-0.5 * far);
  pixel = vec4(mix(color.rgb, flat_color.rgb, flat_color.a) * alpha, alpha);
}`;

export const SCREEN_VERTEX = `#version 300 es
in vec2 corner;
out vec2 uv;
void main() { uv = 0.5 + 0.5 * corner; gl_Position = vec4(corner, 0.0, 1.0); }`;

/** A line where a mark's cover passes one half. */
export const EDGE_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D cover;
uniform vec2 step_;
in vec2 uv;
out vec4 pixel;
void main() {
  vec4 best = vec4(0.0);
  for (int k = 0; k < 8; k++) {
    float turn = 0.7853982 * float(k);
    vec4 near = texture(cover, uv + step_ * vec2(cos(turn), sin(turn)));
    if (near.a > best.a) best = near;
  }
  float here = texture(cover, uv).a;
  float edge = smoothstep(0.35, 0.65, best.a) * (1.0 - smoothstep(0.35, 0.65, here));
  pixel = vec4(best.rgb / max(best.a, 1e-3), 1.0) * edge;
}`;
