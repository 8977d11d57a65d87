"""The programs in GLSL 3.30 that draw particles, meshes, lines and discs."""

from __future__ import annotations

# Lamps of a scene. Programs compute in the coordinates of the camera: x to the right, y upward, z
# toward the eye, which is at the origin.
MOST_LIGHTS = 16

_LIGHT = f"""
uniform bool is_lit, is_orthographic;
uniform vec3 ambient;
uniform int light_count;
uniform vec3 light_places[{MOST_LIGHTS}], light_colors[{MOST_LIGHTS}];
vec3 shaded(vec3 color, vec3 place, vec3 normal) {{
  if (!is_lit) return color;
  vec3 light = ambient;
  for (int i = 0; i < light_count; ++i) {{
    vec3 way = normalize(light_places[i] - place);
    light += light_colors[i] * max(dot(normal, way), 0.0);
  }}
  return color * light;
}}
"""
_HEAD = "#version 330\n"
# Outside of all clipping planes: a particle whose place is no number is left out.
_NOWHERE = "vec4(2, 2, 2, 1)"

# A square in front of each ball covers its outline as the eye sees it.
_PARTICLE_CORNERS = f"""{_HEAD}
uniform mat4 view, projection;
uniform vec2 resolution;
uniform bool is_orthographic;
in vec3 center;
in float radius;
in vec4 color;
out vec3 place;
flat out vec3 middle, tint;
flat out float size;
void main() {{
  vec2 corner = 2 * vec2(gl_VertexID & 1, gl_VertexID >> 1) - 1;
  middle = (view * vec4(center, 1)).xyz;
  size = radius;
  tint = color.rgb;
  float distance2 = dot(middle, middle), size2 = size * size;
  bool is_there = distance2 < 1e30 && size > 0 && (is_orthographic || distance2 > size2);
  vec3 right = vec3(1, 0, 0), up = vec3(0, 1, 0);
  float reach = size, distance = 1;
  if (!is_orthographic) {{
    vec3 axis = middle * inversesqrt(distance2);
    right = normalize(cross(axis, abs(axis.y) < 0.9 ? vec3(0, 1, 0) : vec3(1, 0, 0)));
    up = cross(right, axis);
    reach = size * sqrt(distance2 / (distance2 - size2));
    distance = sqrt(distance2);
  }}
  // One pixel more, so that the square covers all samples of the outline's pixels.
  reach += 2 * distance / (projection[1][1] * resolution.y);
  place = middle + reach * (corner.x * right + corner.y * up);
  gl_Position = is_there ? projection * vec4(place, 1) : {_NOWHERE};
}}
"""
_PARTICLE_PIXELS = f"""{_HEAD}
uniform mat4 projection;
in vec3 place;
flat in vec3 middle, tint;
flat in float size;
out vec4 pixel;
{_LIGHT}
void main() {{
  vec3 way = is_orthographic ? vec3(0, 0, -1) : normalize(place);
  vec3 origin = is_orthographic ? vec3(place.xy, 0) : vec3(0);
  float along = dot(middle - origin, way);
  vec3 off = origin + along * way - middle;
  float depth2 = size * size - dot(off, off);
  if (depth2 < 0) discard;
  vec3 hit = origin + (along - sqrt(depth2)) * way;
  vec4 clip = projection * vec4(hit, 1);
  float depth = 0.5 * clip.z / clip.w + 0.5;
  if (depth < 0 || depth > 1) discard;
  gl_FragDepth = depth;
  pixel = vec4(shaded(tint, hit, (hit - middle) / size), 1);
}}
"""

_MESH_CORNERS = f"""{_HEAD}
uniform mat4 view, projection;
in vec3 position, normal;
in vec4 color;
out vec3 place, upward;
out vec4 tint;
void main() {{
  place = (view * vec4(position, 1)).xyz;
  upward = mat3(view) * normal;
  tint = color;
  gl_Position = projection * vec4(place, 1);
}}
"""
_MESH_PIXELS = f"""{_HEAD}
uniform bool is_two_sided;
in vec3 place, upward;
in vec4 tint;
out vec4 pixel;
{_LIGHT}
void main() {{
  vec3 normal = dot(upward, upward) > 0 ? normalize(upward) : vec3(0);
  vec3 way = is_orthographic ? vec3(0, 0, -1) : place;
  if (is_two_sided && dot(normal, way) > 0) normal = -normal;
  pixel = vec4(shaded(tint.rgb, place, normal), tint.a);
}}
"""

# A rectangle along each line, `width` pixels wide; the part behind the eye is cut off.
_LINE_CORNERS = f"""{_HEAD}
uniform mat4 view, projection;
uniform vec2 resolution;
uniform float width, nearest;
in vec3 begin, end;
in vec4 begin_color, end_color;
out vec4 tint;
void main() {{
  vec3 a = (view * vec4(begin, 1)).xyz, b = (view * vec4(end, 1)).xyz;
  float limit = -nearest;
  bool is_there = (a.z < limit || b.z < limit) && dot(a, a) + dot(b, b) < 1e30;
  vec3 from = a.z < limit ? a : mix(b, a, (limit - b.z) / (a.z - b.z));
  vec3 to = b.z < limit ? b : mix(a, b, (limit - a.z) / (b.z - a.z));
  vec4 first = projection * vec4(from, 1), last = projection * vec4(to, 1);
  vec2 way = (last.xy / last.w - first.xy / first.w) * resolution;
  way = dot(way, way) > 0 ? normalize(way) : vec2(1, 0);
  vec4 at = (gl_VertexID & 1) == 0 ? first : last;
  tint = (gl_VertexID & 1) == 0 ? begin_color : end_color;
  float side = gl_VertexID < 2 ? -1.0 : 1.0;
  at.xy += side * width / resolution * vec2(-way.y, way.x) * at.w;
  gl_Position = is_there ? at : {_NOWHERE};
}}
"""
_COLOR_PIXELS = f"""{_HEAD}
in vec4 tint;
out vec4 pixel;
void main() {{ pixel = tint; }}
"""

# The shader for discs of the canvas, whose edges are smooth over one pixel.
_DISC_CORNERS = f"""{_HEAD}
uniform mat4 view, projection;
uniform vec2 resolution;
in vec3 center;
in float radius;
in vec4 color;
out vec2 off;
flat out float reach;
flat out vec4 tint;
void main() {{
  vec2 corner = 2 * vec2(gl_VertexID & 1, gl_VertexID >> 1) - 1;
  reach = radius;
  tint = color;
  off = corner * (radius + 1);
  bool is_there = dot(center, center) < 1e30;
  vec4 middle = projection * view * vec4(center, 1);
  gl_Position = is_there ? middle + vec4(2 * off / resolution, 0, 0) : {_NOWHERE};
}}
"""
_DISC_PIXELS = f"""{_HEAD}
in vec2 off;
flat in float reach;
flat in vec4 tint;
out vec4 pixel;
void main() {{
  float cover = clamp(reach + 0.5 - length(off), 0.0, 1.0);
  if (cover == 0) discard;
  pixel = vec4(tint.rgb, tint.a * cover);
}}
"""

_IMAGE_CORNERS = f"""{_HEAD}
uniform bool is_upright;
out vec2 place;
void main() {{
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  place = is_upright ? corner : vec2(corner.x, 1 - corner.y);
  gl_Position = vec4(2 * corner - 1, 0, 1);
}}
"""
_IMAGE_PIXELS = f"""{_HEAD}
uniform sampler2D image;
in vec2 place;
out vec4 pixel;
void main() {{ pixel = texture(image, place); }}
"""

# For each shader program, the sources for vertices and for pixels.
PROGRAMS = {
    "particles": (_PARTICLE_CORNERS, _PARTICLE_PIXELS),
    "mesh": (_MESH_CORNERS, _MESH_PIXELS),
    "lines": (_LINE_CORNERS, _COLOR_PIXELS),
    "discs": (_DISC_CORNERS, _DISC_PIXELS),
    "image": (_IMAGE_CORNERS, _IMAGE_PIXELS),
}
