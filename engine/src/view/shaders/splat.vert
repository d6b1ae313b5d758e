#version 300 es
// One instance per Gaussian, one corner of its footprint per vertex.
//
// A record (packet.rs) is taken to the time t of its interval, into scene space, and into the view:
//   position = mean + velocity·τ,   opacity = o · (1 + e^(−γ₀γ₁)) / (1 + e^(γ₀(|τ| − γ₁))) · handover,   τ = t − t₀
//   colour   = rgb + rate·τ
//   scene    = (x, −z, 1 / (9.8·y + 0.2 + 10⁻⁶)) for y in [0, 1]
//   square   = scene with x and z, and deviations along them, times `units`: what the camera sees
//   Σ        = J·R·S·Sᵀ·Rᵀ·Jᵀ + 0.3·I   (px²), with S widened where the image shows more pixels per unit than the model (render/view.rs)
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp isampler2D;

uniform usampler2D records;
uniform isampler2D rates;
uniform float rateStep;   // 0 where colours stay
uniform vec3 positionLow, positionStep, velocityLow, velocityStep;
uniform float t;
uniform vec3 eye;
uniform mat3 turn;    // columns: the camera's right, down and forward
uniform vec2 focal;   // pixels per unit, or, for a pinhole, focal lengths in pixels
uniform float units;  // square units along x and z per unit of scene space
uniform bool pinhole;
uniform vec2 own;     // the model's pixels per square unit
uniform vec2 size;    // pixels
uniform int mode;     // 0 colour, 1 inverse depth, 2 identity

layout(location = 0) in uint record;

out vec2 w;
flat out vec4 splat;  // what is blended, and the opacity

// footprint.vert
const float VISIBLE = 1.0 / 255.0;
const float LOW_PASS = 0.3;
void footprint(vec2 centre, vec3 m1, vec3 m2, vec3 value, float opacity);
vec3 colourOf(uint number);

const float VANISHED = 87.0;
const float HANDOVER = 0.125;
const uint PER_ROW = 1024u;

vec2 halves(uint word) { return vec2(word & 0xffffu, word >> 16); }

float opacityFactor(vec2 gamma, float tau) {
  float x = gamma.x * (abs(tau) - gamma.y);
  return x > VANISHED ? 0.0 : min(1.0, (1.0 + exp(-gamma.x * gamma.y)) / (1.0 + exp(x)));
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside, until it is known to be seen
  w = vec2(0.0);
  splat = vec4(0.0);

  ivec2 place = ivec2(int(record % PER_ROW) * 2, int(record / PER_ROW));
  uvec4 a = texelFetch(records, place, 0);
  uvec4 b = texelFetch(records, place + ivec2(1, 0), 0);
  uint flags = b.w >> 24;

  float tau = t - float(flags & 1u);
  vec2 xy = halves(a.x), zu = halves(a.y), vw = halves(a.z);
  vec3 velocity = velocityLow + velocityStep * vec3(zu.y, vw);
  vec3 world = positionLow + positionStep * vec3(xy, zu.x) + velocity * tau;
  if (world.y < 0.0 || world.y > 1.0) return;

  vec2 gamma = vec2(unpackHalf2x16(a.w).x, float(a.w >> 16) / 65535.0);
  uint handover = (flags >> 1) & 3u;
  float ramp = handover == 1u ? t : handover == 2u ? 1.0 - t : HANDOVER;
  float opacity = float(b.x >> 24) / 255.0 * opacityFactor(gamma, tau) * min(1.0, ramp / HANDOVER);
  if (opacity < VISIBLE) return;

  vec3 scene = vec3(world.x, -world.z, 1.0 / (9.8 * world.y + 0.200001));
  vec3 square = vec3(units, 1.0, units);
  vec3 view = (square * scene - eye) * turn;
  if (view.z <= (pinhole ? 1e-3 : 0.0)) return;

  vec2 s = unpackHalf2x16(b.y);
  float thickness = exp2(0.25 * float(int(b.w) >> 27));
  vec3 sigma = square * vec3(s, 0.5 * (s.x + s.y) * thickness);
  vec2 unit = pinhole ? focal / view.z : focal;
  vec2 more = LOW_PASS * max(vec2(0.0), 1.0 / (own * own) - 1.0 / (unit * unit));
  sigma = sqrt(sigma * sigma + vec3(more, 0.5 * (more.x + more.y)));
  vec3 m1 = turn[0] * sigma, m2 = turn[1] * sigma, m3 = turn[2] * sigma;
  vec2 centre = focal * view.xy;
  if (pinhole) {
    vec2 slope = view.xy / view.z;
    centre = focal * slope;
    m1 = focal.x / view.z * (m1 - slope.x * m3);
    m2 = focal.y / view.z * (m2 - slope.y * m3);
  } else {
    m1 *= focal.x;
    m2 *= focal.y;
  }
  vec3 rgb = vec3(b.x & 255u, (b.x >> 8) & 255u, (b.x >> 16) & 255u) / 255.0;
  if (rateStep > 0.0) {
    rgb += rateStep * tau * vec3(texelFetch(rates, ivec2(int(record % PER_ROW), int(record / PER_ROW)), 0).rgb);
  }
  vec3 value = mode == 0 ? rgb
             : mode == 1 ? vec3(world.y, 0.0, 0.0)
             : colourOf(b.z);
  footprint(centre, m1, m2, value, opacity);
}
