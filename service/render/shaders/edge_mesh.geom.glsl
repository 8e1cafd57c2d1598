// An edge with the vertices opposite to it on its two faces, as a rectangle on the screen where the edge is a line, else as nothing:
//
//          b = 2
//         /|\                       1 ---------------- 3
//    0   / | \   3                  |  a ---------- b  |     reaches a half width beyond the edge
//        \ | /                      0 ---------------- 2     on every side
//         \|/
//          a = 1                    left face a, b, 0; right face b, a, 3; at a border 3 is 1
//
// Definitions: BORDERS (some edges have one face), BACKS_HIDDEN (no back face can be seen), EITHER_SIDE (convex and concave are as seen from the eye, whatever side of the
// surface that is on), CREASES (ridges or valleys are wanted), MOVED (angles are those of the positions, not the given ones).
layout(lines_adjacency) in;
layout(triangle_strip, max_vertices = 4) out;

//! include placed.part.glsl
uniform vec4 eye;           // less the middle, scaled; w is 0 for a direction
uniform vec2 size;          // target pixels
uniform vec2 reach;         // how far beyond the target lines are not cut off, 1 at its border
uniform vec4 half_widths;   // of each kind, target pixels; 0 where it is not drawn
uniform float least_half_width;
uniform float width_at;     // clip w where those widths are meant; 0 where they are the same everywhere
uniform float widest;       // times the width that is meant
uniform float least_w;      // nearer parts of an edge are cut off
uniform float pixel_depth;  // what the size of a pixel is in window depth,
uniform float pixel_depth_at;  // where clip w is this
uniform int only;           // the one kind that is drawn; all below 0
#ifdef CREASES
uniform float ridge_deg;
uniform float valley_deg;
#ifndef MOVED
uniform sampler2D angles;
#endif
#endif

in vec3 position[];
#ifdef BORDERS
flat in int vertex[];
#endif
flat out vec4 ends;   // target pixels: x, y of a; x, y of b
flat out vec4 shape;  // half widths at a and b, window depths of a and b
flat out vec2 style;  // depth by which a surface before the edge does not hide it; kind

const int SILHOUETTE = 0, BOUNDARY = 1, RIDGE = 2, VALLEY = 3;
const float CERTAIN = 1e-6;  // sine of an angle that float32 is sure of
const float STEEPEST = 4.0;  // pixels of depth for a pixel across

float pixels_of_depth(vec4 a, vec4 b) {
    return pixel_depth * pixel_depth_at / max(min(a.w, b.w), least_w);
}

vec3 in_window(vec4 clip) {
    vec3 p = clip.xyz / max(clip.w, least_w) * 0.5 + 0.5;
    return vec3(p.xy * size, p.z);
}

float slope(vec3 a, vec3 b, vec3 c) {
    vec3 n = cross(b - a, c - a);
    return length(n.xy) / max(abs(n.z), 1e-20);
}

#ifdef CREASES
float angle_deg(vec3 along, vec3 left, vec3 right) {
#ifdef MOVED
    vec3 n = cross(along, left), m = cross(right, along);
    n *= inversesqrt(max(dot(n, n), 1e-36));
    m *= inversesqrt(max(dot(m, m), 1e-36));
    float angle = degrees(atan(length(cross(n, m)), dot(n, m)));
    return dot(n, right) > 0.0 ? -angle : angle;
#else
    int columns = textureSize(angles, 0).x;
    return texelFetch(angles, ivec2(gl_PrimitiveIDIn % columns, gl_PrimitiveIDIn / columns), 0).r;
#endif
}
#endif

// the kind of line that the edge is, -1 for none
int kind_of(vec3 along, vec3 left, vec3 right, out bool concave) {
    concave = false;
#ifdef BORDERS
    if (vertex[3] == vertex[1]) return BOUNDARY;
#endif
    vec3 to_eye = eye.xyz - eye.w * ((position[1] - middle) - middle_rest);
    vec3 across = cross(along, to_eye);
    bool left_front = dot(left, across) <= 0.0, right_front = dot(right, across) >= 0.0;
    bool folds = left_front != right_front;
#ifdef BACKS_HIDDEN
    if (!left_front && !right_front) return -1;
#endif
#ifndef CREASES
    if (!folds) return -1;
#endif
    vec3 n = cross(along, left);
    float height = dot(n, right);
    concave = height > CERTAIN * length(n) * length(right);
#ifdef BACKS_HIDDEN
    if (folds && concave) return -1;  // its faces hide it: the nearer of them is a back face
#endif
    if (folds && half_widths[SILHOUETTE] > 0.0) return SILHOUETTE;
#ifdef CREASES
    float angle = angle_deg(along, left, right);
#ifdef EITHER_SIDE
    if (!left_front) angle = -angle;
#endif
    if (angle > ridge_deg && half_widths[RIDGE] > 0.0) return RIDGE;
    if (-angle > valley_deg && half_widths[VALLEY] > 0.0) return VALLEY;
#endif
    return -1;
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

void put(vec2 corner, int kind) {
    // each kind is before the next one, so that of two lines the more important one is seen
    gl_Position = vec4(corner / size * 2.0 - 1.0, 0.25 * float(kind) - 0.5, 1.0);
    EmitVertex();
}

void main() {
    vec3 along = position[2] - position[1], left = position[0] - position[1], right = position[3] - position[1];
    bool concave;
    int kind = kind_of(along, left, right, concave);
    if (kind < 0 || half_widths[kind] <= 0.0 || (only >= 0 && kind != only)) return;

    vec4 a = placed(position[1]), b = placed(position[2]);
    vec2 part = part_in_view(a, b);
    if (part.x > part.y) return;
    vec4 first = mix(a, b, part.x), last = mix(a, b, part.y);
    vec3 p = in_window(first), q = in_window(last);

    vec2 half_width = vec2(half_widths[kind]);
    if (width_at > 0.0) half_width = max(half_width * min(width_at / vec2(first.w, last.w), widest), least_half_width);
    float bias = pixels_of_depth(first, last);
    if (concave) {
        // where a pixel's centre is not on the edge, the surface is nearer than the edge by no more than this
        float steeper = max(slope(p, q, in_window(placed(position[0]))), slope(p, q, in_window(placed(position[3]))));
        bias += min(0.75 * steeper, STEEPEST * bias);
    }
    ends = vec4(p.xy, q.xy);
    shape = vec4(half_width, clamp(vec2(p.z, q.z), 0.0, 1.0));
    style = vec2(bias, float(kind));
    vec2 forward = q.xy - p.xy;
    forward = dot(forward, forward) > 1e-12 ? normalize(forward) : vec2(1.0, 0.0);
    vec2 aside = vec2(-forward.y, forward.x);
    put(p.xy - half_width.x * (forward + aside), kind);
    put(p.xy - half_width.x * (forward - aside), kind);
    put(q.xy + half_width.y * (forward - aside), kind);
    put(q.xy + half_width.y * (forward + aside), kind);
}
