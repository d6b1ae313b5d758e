#version 300 es
// One instance per Gaussian of a still scene, one corner of its footprint per vertex.
//
// A record (still/packet.rs) is taken into the view, with Σ = J·R·S·Sᵀ·Rᵀ·Jᵀ + 0.3·I (px²). In J, as in `Request::bounded`, what lies beside a pinhole's
// image by more than 15 % of it is taken to lie there. Colours are those of the harmonics from the eye (kernels/src/harmonics).
precision highp float;
precision highp int;
precision highp usampler2D;

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

layout(location = 0) in uint record;

out vec2 w;
flat out vec4 splat;  // what is blended, and the opacity

// footprint.vert
const float VISIBLE = 1.0 / 255.0;
const float LOW_PASS = 0.3;
float share(vec3 m1, vec3 m2);
void footprint(vec2 centre, vec3 m1, vec3 m2, vec3 value, float opacity);
vec3 colourOf(uint number);

const uint PER_ROW = 1024u;
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
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside, until it is known to be seen
  w = vec2(0.0);
  splat = vec4(0.0);

  ivec2 place = ivec2(int(record % PER_ROW) * 2, int(record / PER_ROW));
  uvec4 a = texelFetch(records, place, 0);
  uvec4 b = texelFetch(records, place + ivec2(1, 0), 0);
  float opacity = float(b.x >> 16) / 65535.0;
  if (opacity < VISIBLE) return;

  vec3 away = uintBitsToFloat(a.xyz) - eye;
  vec3 view = away * turn;
  if (view.z <= (pinhole ? 1e-6 : 0.0)) return;

  vec3 sigma = exp(48.0 / 65535.0 * vec3(halves(a.w), b.x & 0xffffu) - 24.0);
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
  footprint(centre, m1, m2, clamp(value, 0.0, 1e3), opacity);
}
