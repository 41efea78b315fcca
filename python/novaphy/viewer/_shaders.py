"""GLSL shaders for both OpenGL 3.3 and WebGL 2. Each renderer prepends its #version header."""

GL_HEADER = "#version 330\n"
WEB_HEADER = (
    "#version 300 es\nprecision highp float;\nprecision highp int;\n"
    "precision highp sampler2DShadow;\n"
)

# Vertex shader of instances. A vertex moves along local z by its `shift` times `scale.w`.
MESH_VERTEX = """
in vec3 position; in vec3 normal; in float shift;
in vec3 body_p; in vec4 body_q; in vec3 local_p; in vec4 local_q; in vec4 scale; in vec4 color;
uniform mat4 view_projection; uniform mat4 light_projection;
out vec3 world; out vec3 world_normal; out vec3 light_position; out vec2 pattern; out vec4 tint;
vec3 turn(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
void main() {
  vec3 p = position * scale.xyz + vec3(0.0, 0.0, shift * scale.w);
  pattern = p.xy;
  world = body_p + turn(body_q, local_p + turn(local_q, p));
  world_normal = turn(body_q, turn(local_q, normal / scale.xyz));
  light_position = (light_projection * vec4(world, 1.0)).xyz * 0.5 + 0.5;
  tint = color;
  gl_Position = view_projection * vec4(world, 1.0);
  // Faces of two shapes in one plane: one of them is nearer, by 0.8 mm at 1 m for each instance.
  gl_Position.z -= 1.6e-5 * float(gl_InstanceID & 7) * gl_Position.w;
}
"""

# Fragment shader: a light with a shadow map, sky light, an antialiased checker, and distance haze.
MESH_FRAGMENT = """
in vec3 world; in vec3 world_normal; in vec3 light_position; in vec2 pattern; in vec4 tint;
uniform vec3 eye; uniform vec3 target; uniform vec3 light; uniform vec3 up; uniform vec3 haze;
uniform float cell; uniform float reach; uniform sampler2DShadow shadow_map;
out vec4 pixel;
float checker(vec2 c) {
  vec2 w = max(fwidth(c), vec2(1e-4));
  vec2 a = abs(fract((c - 0.5 * w) * 0.5) - 0.5), b = abs(fract((c + 0.5 * w) * 0.5) - 0.5);
  vec2 i = 2.0 * (a - b) / w;
  return 0.5 - 0.5 * i.x * i.y;
}
float lit(float slope) {
  vec3 p = light_position;
  if (any(lessThan(p, vec3(0.0))) || any(greaterThan(p, vec3(1.0)))) return 1.0;
  float depth = p.z - (0.0008 + 0.003 * slope);
  float texel = 1.0 / float(textureSize(shadow_map, 0).x), sum = 0.0;
  for (int x = -1; x <= 1; ++x)
    for (int y = -1; y <= 1; ++y)
      sum += texture(shadow_map, vec3(p.xy + vec2(float(x), float(y)) * texel, depth));
  return sum / 9.0;
}
void main() {
  vec3 n = normalize(world_normal), to_eye = normalize(eye - world);
  if (!gl_FrontFacing) n = -n;
  float facing = max(dot(n, light), 0.0);
  float sun = facing * lit(1.0 - facing);
  vec3 base = tint.rgb;
  if (tint.a > 0.0) base *= mix(1.0 - tint.a, 1.0, checker(pattern / cell));
  vec3 sky = mix(vec3(0.42, 0.41, 0.40), vec3(0.56, 0.58, 0.61), 0.5 + 0.5 * dot(n, up));
  float gloss = tint.a > 0.0 ? 0.0 : 0.18 * pow(max(dot(n, normalize(light + to_eye)), 0.0), 40.0);
  vec3 shade = base * (sky + 0.56 * sun) + gloss * sun;
  float far = tint.a > 0.0 ? smoothstep(0.35, 1.0, distance(world, target) / reach) : 0.0;
  pixel = vec4(mix(shade, haze, far), 1.0);
}
"""

DEPTH_FRAGMENT = """
out vec4 pixel;
void main() { pixel = vec4(1.0); }
"""

# Vertex shader of segments: each is a quad that faces the camera, at least 1.5 pixels wide.
LINE_VERTEX = """
in vec2 corner; in vec3 start; in vec3 end; in vec3 color;
uniform mat4 view_projection; uniform vec3 eye; uniform float width; uniform float pixel_angle;
out vec3 tint;
void main() {
  vec3 axis = end - start, p = mix(start, end, corner.x);
  vec3 side = cross(axis, eye - p);
  float size = length(side);
  float thick = max(width, 1.5 * pixel_angle * distance(eye, p));
  if (size > 0.0) {
    p += side / size * (0.5 * thick * corner.y);
    p += normalize(axis) * (corner.x - 0.5) * 0.5 * thick;
    // As far in front as a tube, and more: the thicker line wins, however thin both are.
    p += normalize(eye - p) * 0.5 * (thick + width);
  }
  tint = color;
  gl_Position = view_projection * vec4(p, 1.0);
}
"""

LINE_FRAGMENT = """
in vec3 tint;
out vec4 pixel;
void main() { pixel = vec4(tint, 1.0); }
"""

OVERLAY_VERTEX = """
in vec2 corner; uniform vec4 place; out vec2 uv;
void main() {
  uv = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4(place.xy + corner * place.zw, 0.0, 1.0);
}
"""

OVERLAY_FRAGMENT = """
in vec2 uv; uniform sampler2D image; out vec4 pixel;
void main() { pixel = texture(image, uv); }
"""
