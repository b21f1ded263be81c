// Shaders: points as discs with a colour by value, surfaces shaded flat, and a line.

const POINT_SHADER = [`#version 300 es
precision highp float;
in vec3 position;
in float value;
in float status;
uniform mat4 matrix;
uniform vec3 eye;
uniform float size, low, high;
uniform int scale;      // 0 linear, 1 logarithmic, 2 a category
uniform uint hidden;    // a bit for each status
uniform bool alarms;    // whether what is no echo has a colour of its own
uniform sampler2D map;
out vec4 colour;
const float PULL_M = 0.2;

void main() {
  gl_Position = matrix * vec4(position, 1.0);
  // Ranges are noisy: a point a little behind its surface is not hidden by it.
  vec4 nearer = matrix * vec4(position + PULL_M * normalize(eye - position), 1.0);
  if (nearer.w > 0.0) gl_Position.z = nearer.z / nearer.w * gl_Position.w;
  gl_PointSize = size * clamp(sqrt(25.0 / max(gl_Position.w, 0.1)), 0.6, 2.5);
  if (scale == 2) {
    int row = int(value) + 1;
    colour = texelFetch(map, ivec2(row % 256, row / 256), 0);
  } else {
    float part = scale == 1 ? log(max(value, 1e-37) / low) / log(high / low) : (value - low) / (high - low);
    colour = value > 1e38 ? vec4(0.42, 0.45, 0.5, 1.0) : texelFetch(map, ivec2(clamp(part, 0.0, 1.0) * 255.0, 0), 0);
  }
  if (alarms && status > 0.0) colour = vec4(1.0, 0.18, 0.82, 1.0);
  if (((hidden >> uint(status)) & 1u) == 1u || colour.a == 0.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`, `#version 300 es
precision highp float;
in vec4 colour;
out vec4 pixel;

void main() {
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  pixel = vec4(colour.rgb, 1.0);
}`];

const SURFACE_SHADER = [`#version 300 es
precision highp float;
in vec3 position;
in vec4 tint;
uniform mat4 matrix;
out vec3 place;
out vec4 colour;

void main() {
  place = position;
  colour = tint;
  gl_Position = matrix * vec4(position, 1.0);
}`, `#version 300 es
precision highp float;
in vec3 place;
in vec4 colour;
uniform vec3 eye, sun;
uniform float opacity;
uniform mat4 toSun;
uniform highp sampler2DShadow shadow;
out vec4 pixel;

// How much of the sun is seen: the mean of nine places of the map around this one.
float lit(vec3 normal) {
  vec3 at = (toSun * vec4(place + 0.06 * normal, 1.0)).xyz * 0.5 + 0.5;
  if (any(lessThan(at, vec3(0.0))) || any(greaterThan(at, vec3(1.0)))) return 1.0;
  vec2 texel = 1.0 / vec2(textureSize(shadow, 0));
  float sum = 0.0;
  for (int i = -1; i <= 1; i++) for (int j = -1; j <= 1; j++)
    sum += texture(shadow, vec3(at.xy + texel * vec2(i, j), at.z - 0.0007));
  return sum / 9.0;
}

void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  vec3 towards = normalize(eye - place);
  normal *= sign(dot(normal, towards));
  float sunlit = sun.z > 0.0 ? max(dot(normal, sun), 0.0) : 0.0;
  if (sunlit > 0.0) sunlit *= lit(normal);
  float light = 0.24 + 0.42 * sunlit + 0.18 * dot(normal, towards);
  float haze = exp(-length(eye - place) / 220.0);
  pixel = vec4(mix(vec3(0.043, 0.055, 0.078), colour.rgb * light, haze), colour.a * opacity);
}`];

const LINE_SHADER = [`#version 300 es
in vec3 position;
uniform mat4 matrix;

void main() {
  gl_Position = matrix * vec4(position, 1.0);
}`, `#version 300 es
precision highp float;
out vec4 pixel;

void main() {
  pixel = vec4(1.0, 1.0, 1.0, 0.45);
}`];
