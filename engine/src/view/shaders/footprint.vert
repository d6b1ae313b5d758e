
// What splat.vert and still.vert share.

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

// The corner of the footprint around `centre`, in pixels from the image's middle, of a Gaussian whose Σ = M·Mᵀ + 0.3·I has the rows m1 and m2
// in M. With Σ = L·Lᵀ, L lower triangular, the place L·w has the exponent −½·|w|²: the square |w|∞ ≤ r, r = √(2·ln(255·o)), holds every
// pixel on which α is at least 1/255.
void footprint(vec2 centre, vec3 m1, vec3 m2, vec3 value, float opacity) {
  vec3 n = cross(m1, m2);
  float aa = dot(m1, m1) + LOW_PASS, cc = dot(m2, m2) + LOW_PASS, bb = dot(m1, m2);
  float det = widened(m1, m2, dot(n, n));
  float l11 = sqrt(aa), l21 = bb / l11, l22 = sqrt(det / aa);

  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  w = corner * sqrt(2.0 * log(255.0 * opacity));
  vec2 pixel = centre + vec2(l11 * w.x, l21 * w.x + l22 * w.y);
  splat = vec4(value, opacity);
  gl_Position = vec4(2.0 * pixel.x / size.x, -2.0 * pixel.y / size.y, 0.0, 1.0);
}
