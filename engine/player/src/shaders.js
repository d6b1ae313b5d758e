// GLSL programs, by name.

// Records in drawing order.
const ORDER = /* glsl */ `
const uint PER_ROW = 1024u;
uniform usampler2D order;  // numbers of records in drawing order
uniform int total;         // how many
uint record;

// Takes the record at a place of the order; false after the last.
bool takeRecord(int at) {
  if (at >= total) return false;
  record = texelFetch(order, ivec2(at % int(PER_ROW), at / int(PER_ROW)), 0).r;
  return true;
}
`;

// Footprints: Σ = M·Mᵀ + 0.3·I has the rows m1 and m2 in M.
const FOOTPRINT = /* glsl */ `
const float VISIBLE = 1.0 / 255.0;
const float LOW_PASS = 0.3;

// A colour for a number: hues a golden section apart, so that neighbours differ.
vec3 colourOf(uint number) {
  uint h = number * 2654435769u;
  float hue = float(h >> 8) / 16777216.0;
  float light = 0.62 + 0.3 * float((h >> 3) & 7u) / 7.0;
  vec3 rgb = clamp(abs(fract(hue + vec3(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0);
  return light * mix(vec3(1.0), rgb, 0.62);
}

// det Σ of Σ = M·Mᵀ + 0.3·I with the rows m1 and m2 in M, given det(M·Mᵀ).
float widened(vec3 m1, vec3 m2, float det) {
  return det + LOW_PASS * (dot(m1, m1) + dot(m2, m2) + LOW_PASS);
}

// The part of the opacity that anti-aliasing keeps: √(det(M·Mᵀ) / det Σ).
float share(vec3 m1, vec3 m2) {
  vec3 n = cross(m1, m2);
  float det = dot(n, n);
  return sqrt(det / widened(m1, m2, det));
}

// L of Σ = L·Lᵀ, lower triangular: l11, l21, l22.
vec3 lower(vec3 m1, vec3 m2) {
  vec3 n = cross(m1, m2);
  float aa = dot(m1, m1) + LOW_PASS, bb = dot(m1, m2);
  float l11 = sqrt(aa);
  return vec3(l11, bb / l11, sqrt(widened(m1, m2, dot(n, n)) / aa));
}

// The place L·w has the exponent −½·|w|²: the square |w|∞ ≤ r holds every pixel on which α is at least 1/255.
float radius(float opacity) { return sqrt(2.0 * log(255.0 * opacity)); }
`;

// Each record has four vertices and each instance 1024 records, because software renderers spend time on every instance.
const CORNER = /* glsl */ `
uniform vec2 middle;  // where the camera's forward is seen, in pixels from the image's middle
out vec2 w;
flat out vec4 splat;  // what is blended, and the opacity

int placeOfVertex() { return gl_InstanceID * 1024 + (gl_VertexID >> 2); }

// Outside the image unless the record is visible.
void hide() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  w = vec2(0.0);
  splat = vec4(0.0);
}

// A corner of the footprint around its centre, in pixels from where the camera's forward is seen.
void corner(vec2 centre, vec3 l, float r, vec4 value, vec2 size) {
  w = r * (vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0);
  vec2 pixel = centre + middle + vec2(l.x * w.x, l.y * w.x + l.z * w.y);
  splat = value;
  gl_Position = vec4(2.0 * pixel.x / size.x, -2.0 * pixel.y / size.y, 0.0, 1.0);
}
`;

const PRECISE = /* glsl */ `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp isampler2D;
`;

const SPLAT = /* glsl */ `
// A Gaussian in the view.
//
// A record (packet.rs) is taken to the time t of its interval, into scene space, and into the view:
//   position = mean + velocity·τ,   opacity = o · (1 + e^(−γ₀γ₁)) / (1 + e^(γ₀(|τ| − γ₁))) · handover,   τ = t − t₀
//   colour   = rgb + rate·τ
//   scene    = (x, −z, 1 / (9.8·y + 0.2 + 10⁻⁶)) for y in [0, 1]
//   square   = scene with x and z, and deviations along them, times units: what the camera sees
//   Σ        = J·R·S·Sᵀ·Rᵀ·Jᵀ + 0.3·I   (px²), with S widened where the image shows more pixels per unit than the model (render/view.rs)

uniform usampler2D records;
uniform isampler2D rates;
uniform float rateStep;   // 0 where colours stay
uniform float beyond;     // by which colours exceed 0 and 1
uniform vec3 positionLow, positionStep, velocityLow, velocityStep;
uniform float t;
uniform vec3 eye;
uniform mat3 turn;    // columns: the camera's right, down and forward
uniform vec2 focal;   // pixels per unit, or, for a pinhole, focal lengths in pixels
uniform float units;  // square units along x and z per unit of scene space
uniform bool pinhole;
uniform vec2 own;     // the model's pixels per square unit
uniform int mode;     // 0 colour, 1 inverse depth, 2 identity
uniform float grow;   // factor of deviations: above 1 where some Gaussians stand for all

float ahead;          // depth in the view, in square units

const float VANISHED = 87.0;
const float HANDOVER = 0.125;

vec2 halves(uint word) { return vec2(word & 0xffffu, word >> 16); }

float opacityFactor(vec2 gamma, float tau) {
  float x = gamma.x * (abs(tau) - gamma.y);
  return x > VANISHED ? 0.0 : min(1.0, (1.0 + exp(-gamma.x * gamma.y)) / (1.0 + exp(x)));
}

// The record's place in pixels from where the camera's forward is seen, M's rows, and what is blended; false where it is not seen.
bool splatOf(out vec2 centre, out vec3 m1, out vec3 m2, out vec3 value, out float opacity) {
  ivec2 place = ivec2(int(record % PER_ROW) * 2, int(record / PER_ROW));
  uvec4 a = texelFetch(records, place, 0);
  uvec4 b = texelFetch(records, place + ivec2(1, 0), 0);
  uint flags = b.w >> 24;

  float tau = t - float(flags & 1u);
  vec2 xy = halves(a.x), zu = halves(a.y), vw = halves(a.z);
  vec3 velocity = velocityLow + velocityStep * vec3(zu.y, vw);
  vec3 world = positionLow + positionStep * vec3(xy, zu.x) + velocity * tau;
  if (world.y < 0.0 || world.y > 1.0) return false;

  vec2 gamma = vec2(unpackHalf2x16(a.w).x, float(a.w >> 16) / 65535.0);
  uint handover = (flags >> 1) & 3u;
  float ramp = handover == 1u ? t : handover == 2u ? 1.0 - t : HANDOVER;
  opacity = float(b.x >> 24) / 255.0 * opacityFactor(gamma, tau) * min(1.0, ramp / HANDOVER);
  if (opacity < VISIBLE) return false;

  vec3 scene = vec3(world.x, -world.z, 1.0 / (9.8 * world.y + 0.200001));
  vec3 square = vec3(units, 1.0, units);
  vec3 view = (square * scene - eye) * turn;
  ahead = view.z;
  if (view.z <= (pinhole ? 1e-3 : 0.0)) return false;

  vec2 s = unpackHalf2x16(b.y);
  float thickness = exp2(0.25 * float(int(b.w) >> 27));
  vec3 sigma = square * vec3(s, 0.5 * (s.x + s.y) * thickness);
  vec2 unit = pinhole ? focal / view.z : focal;
  vec2 more = LOW_PASS * max(vec2(0.0), 1.0 / (own * own) - 1.0 / (unit * unit));
  sigma = grow * sqrt(sigma * sigma + vec3(more, 0.5 * (more.x + more.y)));
  m1 = turn[0] * sigma;
  m2 = turn[1] * sigma;
  vec3 m3 = turn[2] * sigma;
  centre = focal * view.xy;
  if (pinhole) {
    vec2 slope = view.xy / view.z;
    centre = focal * slope;
    m1 = focal.x / view.z * (m1 - slope.x * m3);
    m2 = focal.y / view.z * (m2 - slope.y * m3);
  } else {
    m1 *= focal.x;
    m2 *= focal.y;
  }
  vec3 rgb = vec3(b.x & 255u, (b.x >> 8) & 255u, (b.x >> 16) & 255u) * (1.0 + 2.0 * beyond) / 255.0 - beyond;
  if (rateStep > 0.0) {
    vec3 steps = vec3(texelFetch(rates, ivec2(int(record % PER_ROW), int(record / PER_ROW)), 0).rgb);
    rgb += rateStep * tau * steps * abs(steps);
  }
  value = mode == 0 ? rgb
             : mode == 1 ? vec3(world.y, 0.0, 0.0)
             : colourOf(b.z);
  return true;
}
`;

export const SHADERS = {
  // Both steps at once, for other engines.
  "splat.vert": /* glsl */ `${PRECISE}${ORDER}${FOOTPRINT}${SPLAT}${CORNER}
uniform vec2 size;  // pixels

void main() {
  hide();
  vec2 centre;
  vec3 m1, m2, value;
  float opacity;
  if (!takeRecord(placeOfVertex()) || !splatOf(centre, m1, m2, value, opacity)) return;
  corner(centre, lower(m1, m2), radius(opacity), vec4(value, opacity), size);
}
`,

  // The first step: what all four corners have in common, a texel for each record of the order.
  "prepare.frag": /* glsl */ `${PRECISE}${ORDER}${FOOTPRINT}${SPLAT}
layout(location = 0) out uvec4 place;  // centre, l11, l21
layout(location = 1) out uvec4 more;   // l22, opacity, red and green, blue and radius; of inverse depths, that in place of red and green

void main() {
  place = more = uvec4(0u);
  vec2 centre;
  vec3 m1, m2, value;
  float opacity;
  ivec2 at = ivec2(gl_FragCoord.xy);
  if (!takeRecord(at.y * int(PER_ROW) + at.x) || !splatOf(centre, m1, m2, value, opacity)) return;
  vec3 l = lower(m1, m2);
  uint first = mode == 1 ? floatBitsToUint(value.x) : packHalf2x16(value.xy);
  place = floatBitsToUint(vec4(centre, l.xy));
  // Rounded up: the square has every pixel.
  more = uvec4(floatBitsToUint(l.z), floatBitsToUint(opacity), first, packHalf2x16(vec2(value.z, 1.001 * radius(opacity))));
}
`,

  // The second.
  "quad.vert": /* glsl */ `${PRECISE}${CORNER}
uniform usampler2D places, others;  // as prepare.frag has them
uniform int total;
uniform int mode;
uniform vec2 size;  // pixels

void main() {
  hide();
  int record = placeOfVertex();
  if (record >= total) return;
  ivec2 at = ivec2(record & 1023, record >> 10);
  uvec4 more = texelFetch(others, at, 0);
  if (more.y == 0u) return;
  vec4 place = uintBitsToFloat(texelFetch(places, at, 0));
  vec2 last = unpackHalf2x16(more.w), first = mode == 1 ? vec2(uintBitsToFloat(more.z), 0.0) : unpackHalf2x16(more.z);
  corner(place.xy, vec3(place.zw, uintBitsToFloat(more.x)), last.y, vec4(first, last.x, uintBitsToFloat(more.y)), size);
}
`,

  "still.vert": /* glsl */ `${PRECISE}${ORDER}${FOOTPRINT}${CORNER}
// One corner of the footprint of a still scene's Gaussian per vertex.
//
// A record (still/packet.rs) is taken into the view, with Σ = J·R·S·Sᵀ·Rᵀ·Jᵀ + 0.3·I (px²). In J, as in Request::bounded, what is outside a pinhole's
// image by more than 15 % of it is taken to be at that distance. Colours are those of the harmonics from the eye (kernels/src/harmonics).
uniform usampler2D records;
uniform usampler2D rows;  // harmonics, one texel per degree
uniform int degree;
uniform bool antialiased; // the scene's mark: o·√(det(Σ − 0.3·I) / det Σ)
uniform vec3 eye;
uniform mat3 turn;    // columns: the camera's right, down and forward
uniform vec2 focal;   // pixels per scene unit, or, for a pinhole, focal lengths in pixels
uniform bool pinhole;
uniform vec2 size;    // pixels
uniform int mode;     // 0 colour, 1 depth, 2 each in a colour of its own
uniform vec2 ends;    // depths of the scale's ends, near and far
uniform float grow;   // factor of deviations: above 1 where some Gaussians stand for all

const float BESIDE = 0.65; // of the image, from its middle

vec2 halves(uint word) { return vec2(word & 0xffffu, word >> 16); }

// Columns of the rotation by a quaternion of which three components are kept.
mat3 rotation(uvec3 words) {
  uint left = (words.x >> 15) | ((words.y >> 15) << 1);
  vec3 k = sqrt(0.5) * (vec3(words & 0x7fffu) / 16383.5 - 1.0);
  float l = sqrt(max(0.0, 1.0 - dot(k, k)));
  vec4 q = left == 0u ? vec4(l, k) : left == 1u ? vec4(k.x, l, k.yz) : left == 2u ? vec4(k.xy, l, k.z) : vec4(k, l);
  float u = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + u * z), 2.0 * (x * z - u * y),
              2.0 * (x * y - u * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + u * x),
              2.0 * (x * z + u * y), 2.0 * (y * z - u * x), 1.0 - 2.0 * (x * x + y * y));
}

uvec4 row[3];

float step8(int n) { return float(int(row[n >> 4][(n >> 2) & 3] << (24 - 8 * (n & 3))) >> 24); }

// The coefficients of number k above the first, in steps.
vec3 c(int k) { return vec3(step8(3 * k), step8(3 * k + 1), step8(3 * k + 2)); }

// What the harmonics above the first add, seen along d.
vec3 harmonics(vec3 d) {
  ivec2 place = ivec2(int(record % PER_ROW) * degree, int(record / PER_ROW));
  for (int i = 0; i < degree; i++) row[i] = texelFetch(rows, place + ivec2(i, 0), 0);
  float x = d.x, y = d.y, z = d.z;
  vec3 sum = 0.4886025119029199 * (-y * c(0) + z * c(1) - x * c(2));
  if (degree >= 2) {
    float xx = x * x, yy = y * y, zz = z * z;
    sum += 1.0925484305920792 * (x * y * c(3) - y * z * c(4) - x * z * c(6));
    sum += 0.31539156525252005 * (2.0 * zz - xx - yy) * c(5) + 0.5462742152960396 * (xx - yy) * c(7);
    if (degree >= 3) {
      sum -= 0.5900435899266435 * (y * (3.0 * xx - yy) * c(8) + x * (xx - 3.0 * yy) * c(14));
      sum += 2.890611442640554 * x * y * z * c(9);
      sum -= 0.4570457994644658 * (4.0 * zz - xx - yy) * (y * c(10) + x * c(12));
      sum += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * c(11);
      sum += 1.445305721320277 * z * (xx - yy) * c(13);
    }
  }
  return unpackHalf2x16(row[degree - 1].w).y * sum;
}

void main() {
  hide();
  if (!takeRecord(placeOfVertex())) return;

  ivec2 place = ivec2(int(record % PER_ROW) * 2, int(record / PER_ROW));
  uvec4 a = texelFetch(records, place, 0);
  uvec4 b = texelFetch(records, place + ivec2(1, 0), 0);
  float opacity = float(b.x >> 16) / 65535.0;
  if (opacity < VISIBLE) return;

  vec3 away = uintBitsToFloat(a.xyz) - eye;
  vec3 view = away * turn;
  if (view.z <= (pinhole ? 1e-6 : 0.0)) return;

  vec3 sigma = grow * exp(48.0 / 65535.0 * vec3(halves(a.w), b.x & 0xffffu) - 24.0);
  mat3 own = rotation(uvec3(b.z >> 16, b.w & 0xffffu, b.w >> 16));
  vec3 m1 = (turn[0] * own) * sigma, m2 = (turn[1] * own) * sigma, m3 = (turn[2] * own) * sigma;
  vec2 centre = focal * view.xy;
  if (pinhole) {
    centre /= view.z;
    vec2 slope = clamp(view.xy / view.z, -BESIDE * size / focal, BESIDE * size / focal);
    m1 = focal.x / view.z * (m1 - slope.x * m3);
    m2 = focal.y / view.z * (m2 - slope.y * m3);
  } else {
    m1 *= focal.x;
    m2 *= focal.y;
  }

  if (antialiased) opacity *= share(m1, m2);
  if (opacity < VISIBLE) return;

  vec3 value = mode == 1 ? vec3((ends.y - view.z) / (ends.y - ends.x), 0.0, 0.0) : colourOf(record);
  if (mode == 0) {
    value = vec3(unpackHalf2x16(b.y), unpackHalf2x16(b.z).x);
    if (degree > 0) value += harmonics(pinhole ? normalize(away) : turn[2]);
    value = max(value, 0.0);
  }
  corner(centre, lower(m1, m2), radius(opacity), vec4(clamp(value, 0.0, 1e3), opacity), size);
}`,

  "splat.frag": /* glsl */ `#version 300 es
// α = min(0.99, o·exp(−½|w|²)), nothing under 1/255. Blended front to back: C += (1 − A)·α·c, A += (1 − A)·α.
precision highp float;

in vec2 w;
flat in vec4 splat;
out vec4 colour;

void main() {
  float alpha = min(0.99, splat.a * exp(-0.5 * dot(w, w)));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(splat.rgb * alpha, alpha);
}
`,

  "resolve.vert": /* glsl */ `#version 300 es
// One triangle over the whole image.
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
`,

  "resolve.frag": /* glsl */ `#version 300 es
// From what was blended to what is shown: colours on the background; inverse depths as colours, near ones bright.
precision highp float;
precision highp sampler2D;

uniform sampler2D blended;  // premultiplied: Σ c α T, Σ α T
uniform vec3 background;
uniform int mode;
uniform vec2 range;         // inverse depths of the scale's ends, far and near
uniform ivec2 corner;       // lower left, of the picture in what is drawn into

out vec4 colour;

// Between the seven colours of a scale that rises in lightness (page.css has the same for the legend).
vec3 scale(float x) {
  const vec3 stops[7] = vec3[](
    vec3(0.09, 0.06, 0.20), vec3(0.26, 0.10, 0.41), vec3(0.47, 0.13, 0.44), vec3(0.70, 0.20, 0.38),
    vec3(0.89, 0.35, 0.26), vec3(0.98, 0.61, 0.24), vec3(0.98, 0.93, 0.62));
  float at = clamp(x, 0.0, 1.0) * 6.0;
  int i = min(int(at), 5);
  return mix(stops[i], stops[i + 1], at - float(i));
}

void main() {
  vec4 sum = texelFetch(blended, ivec2(gl_FragCoord.xy) - corner, 0);
  vec3 shown = sum.rgb;
  if (mode == 1) {
    float nearness = sum.r / max(sum.a, 1e-4);
    shown = scale((nearness - range.x) / (range.y - range.x)) * sum.a;
  }
  colour = vec4(shown + (1.0 - sum.a) * background, 1.0);
}
`,
};
