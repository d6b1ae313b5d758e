#version 300 es
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
