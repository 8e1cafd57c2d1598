// An edge that is a line, as a rectangle on the screen that reaches a half width beyond the edge on every side:
//
//      1 ---------------- 3
//      |  a ---------- b  |
//      0 ---------------- 2
//
layout(points) in;
layout(triangle_strip, max_vertices = 4) out;
//! include edge_mesh_kinds.part.glsl
//! include edge_mesh_positions.part.glsl
//! include placed.part.glsl
uniform vec2 size;          // target pixels
uniform vec2 depths;        // where lines of the first kind are before others, and how far those of the next one are behind them
uniform vec2 reach;         // how far beyond the target lines are not cut off, 1 at its border
uniform vec4 half_widths;   // of each kind, target pixels; 0 where it is not drawn
uniform float least_half_width;
uniform float width_at;     // clip w where those widths are meant; 0 where they are the same everywhere
uniform float widest;       // times the width that is meant
uniform float least_w;      // nearer parts of an edge are cut off
uniform vec2 range;         // from window depth to the clip coordinate: scale, shift
uniform float farther;      // sign by which window depth grows with the distance
uniform float pixel_depth;  // what the size of a pixel is in window depth,
uniform float pixel_depth_at;  // where clip w is this

flat in ivec4 edge[];
flat in int kind[];
flat in int concave[];
flat out vec4 ends;   // target pixels: x, y of a; x, y of b
flat out vec4 shape;  // half widths at a and b, window depths of a and b, growing with the distance
flat out vec2 style;  // depth by which a surface before the edge does not hide it; kind

// Depth of a surface before an edge that does not hide it, pixels: where a pixel's centre is not on the edge, the surface
// is at least as deep as the edge unless the edge is concave; then it is nearer, the more so the steeper it is.
const float NOT_HIDING = 1.0, NOT_HIDING_CONCAVE = 5.0;

vec3 in_window(vec4 clip) {
    vec3 p = clip.xyz / clip.w;
    return vec3((p.xy * 0.5 + 0.5) * size, farther * clamp((p.z - range.y) / range.x, 0.0, 1.0));
}

// what of a -> b has a w of least_w and is not beyond one side of the target; empty where x > y
vec2 part_in_view(vec4 a, vec4 b) {
    vec2 part = vec2(0.0, 1.0);
    float at_a[5] = float[5](a.w - least_w, reach.x * a.w - a.x, reach.x * a.w + a.x, reach.y * a.w - a.y, reach.y * a.w + a.y);
    float at_b[5] = float[5](b.w - least_w, reach.x * b.w - b.x, reach.x * b.w + b.x, reach.y * b.w - b.y, reach.y * b.w + b.y);
    for (int i = 0; i < 5; i++) {
        if (at_a[i] < 0.0 && at_b[i] < 0.0) return vec2(1.0, 0.0);
        float t = at_a[i] / (at_a[i] - at_b[i]);
        if (at_a[i] < 0.0) part.x = max(part.x, t);
        else if (at_b[i] < 0.0) part.y = min(part.y, t);
    }
    return part;
}

void put(vec2 corner, int line) {
    // each kind is before the next one, so that of two lines the more important one is seen
    gl_Position = vec4(corner / size * 2.0 - 1.0, depths.x + depths.y * float(line), 1.0);
    EmitVertex();
}

void main() {
    int line = kind[0];
    if (line == NONE || half_widths[line] <= 0.0) return;
    vec4 a = placed(position_of(edge[0].y)), b = placed(position_of(edge[0].z));
    vec2 part = part_in_view(a, b);
    if (part.x > part.y) return;
    vec4 first = mix(a, b, part.x), last = mix(a, b, part.y);
    vec3 p = in_window(first), q = in_window(last);

    vec2 half_width = vec2(half_widths[line]);
    if (width_at > 0.0) half_width = max(half_width * min(width_at / vec2(first.w, last.w), widest), least_half_width);
    ends = vec4(p.xy, q.xy);
    shape = vec4(half_width, p.z, q.z);
    float pixel = pixel_depth * pixel_depth_at / min(first.w, last.w);
    style = vec2(pixel * (concave[0] != 0 ? NOT_HIDING_CONCAVE : NOT_HIDING), float(line));
    vec2 forward = q.xy - p.xy;
    forward = dot(forward, forward) > 1e-12 ? normalize(forward) : vec2(1.0, 0.0);
    vec2 aside = vec2(-forward.y, forward.x);
    put(p.xy - half_width.x * (forward + aside), line);
    put(p.xy - half_width.x * (forward - aside), line);
    put(q.xy + half_width.y * (forward - aside), line);
    put(q.xy + half_width.y * (forward + aside), line);
}
