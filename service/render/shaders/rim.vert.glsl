// Edges of a surface, each as a screen-space rectangle that reaches half_width pixels beyond the edge on every side and
// carries the attributes of the nearer end along it. One instance an edge, a triangle strip of four corners:
//
//      0 ------------------- 2
//      |  a ------------- b  |
//      1 ------------------- 3
//
// Drawn at the far end of the depth range, so that it shows only where no surface is.
//! include srgb.part.glsl
//! include placed.part.glsl
uniform vec2 pixel;  // size of a pixel in normalised device coordinates
uniform float half_width;
in vec3 a_position;
in vec3 b_position;
#ifdef NORMAL
in vec3 a_normal;
in vec3 b_normal;
out vec3 normal;
#endif
#ifdef UV
in vec2 a_uv;
in vec2 b_uv;
out vec2 uv;
#endif
#ifdef COLOR
in vec4 a_color;
in vec4 b_color;
out vec3 color;
#endif

#ifdef SHOW_DEPTH
out vec3 place;
#endif

const float FAR_DEPTH = 0.9999999;

void main() {
    vec4 a = placed(a_position);
    vec4 b = placed(b_position);
    // how far along a -> b the ends are once what lies before the near plane is cut off
    float near_a = a.z + a.w, near_b = b.z + b.w;
    float start = near_a < 0.0 ? near_a / (near_a - near_b) : 0.0;
    float end = near_b < 0.0 ? near_a / (near_a - near_b) : 1.0;
    vec4 first = mix(a, b, start), last = mix(a, b, end);
    vec2 p = first.xy / first.w / pixel, q = last.xy / last.w / pixel;
    vec2 along = q - p;
    along = dot(along, along) > 1e-12 ? normalize(along) : vec2(1.0, 0.0);
    bool at_end = gl_VertexID >= 2;
    float side = (gl_VertexID & 1) == 0 ? 1.0 : -1.0;
    vec2 corner = (at_end ? q + half_width * along : p - half_width * along) + side * half_width * vec2(-along.y, along.x);
    gl_Position = near_a < 0.0 && near_b < 0.0 ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(corner * pixel, FAR_DEPTH, 1.0);
    float t = at_end ? end : start;
#ifdef SHOW_DEPTH
    place = mix(a_position, b_position, t);
#endif
#ifdef NORMAL
    normal = mix(a_normal, b_normal, t);
#endif
#ifdef UV
    uv = mix(a_uv, b_uv, t);
#endif
#ifdef COLOR
    color = mix(linear_from_srgb(a_color.rgb), linear_from_srgb(b_color.rgb), t);
#endif
}
