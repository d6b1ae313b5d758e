#version 300 es
// From what was blended to what is shown: colours on the background; inverse depths as colours, near ones bright.
precision highp float;
precision highp sampler2D;

uniform sampler2D blended;  // premultiplied: Σ c α T, Σ α T
uniform vec3 background;
uniform int mode;
uniform vec2 range;         // inverse depths of the scale's ends, far and near

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
  vec4 sum = texelFetch(blended, ivec2(gl_FragCoord.xy), 0);
  vec3 shown = sum.rgb;
  if (mode == 1) {
    float nearness = sum.r / max(sum.a, 1e-4);
    shown = scale((nearness - range.x) / (range.y - range.x)) * sum.a;
  }
  colour = vec4(shown + (1.0 - sum.a) * background, 1.0);
}
