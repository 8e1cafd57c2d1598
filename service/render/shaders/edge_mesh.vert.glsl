// An edge as a point: decides which kind of line it is in this view, if any.
//
//          b
//         /|\              in_edge: left, a, b, right; at a border right is a
//  left  / | \  right      left face a, b, left; right face b, a, right
//        \ | /
//         \|/
//          a
//
// Definitions: BORDERS (some edges have one face), BACKS_HIDDEN (no back face can be seen), EITHER_SIDE (convex and concave are as seen
// from the eye, whatever side of the surface that is on), CREASES (ridges or valleys are wanted), MOVED (angles are those of the
// positions, not the given ones).
//! include edge_mesh_kinds.part.glsl
//! include edge_mesh_positions.part.glsl
uniform vec3 middle;
uniform vec3 middle_rest;
uniform vec4 eye;          // less the middle, scaled; w is 0 for a direction
uniform vec4 half_widths;  // of each kind; 0 where it is not drawn
uniform int only;          // the one kind that is drawn; all below 0
#ifdef CREASES
uniform float ridge_deg;
uniform float valley_deg;
#endif
in ivec4 in_edge;
#ifdef CREASES
#ifndef MOVED
in float in_angle;  // degrees by which the surface turns, above 0 where it is convex
#endif
#endif
flat out ivec4 edge;
flat out int kind;
flat out int concave;

const float CERTAIN = 1e-6;  // sine of an angle that float32 is sure of

#ifdef CREASES
float angle_deg(vec3 along, vec3 left, vec3 right) {
#ifdef MOVED
    vec3 n = cross(along, left), m = cross(right, along);
    n *= inversesqrt(max(dot(n, n), 1e-36));
    m *= inversesqrt(max(dot(m, m), 1e-36));
    float angle = degrees(atan(length(cross(n, m)), dot(n, m)));
    return dot(n, right) > 0.0 ? -angle : angle;
#else
    return in_angle;
#endif
}
#endif

int kind_of() {
    concave = 0;
#ifdef BORDERS
    if (in_edge.w == in_edge.y) return BOUNDARY;
#endif
    vec3 a = position_of(in_edge.y);
    vec3 along = position_of(in_edge.z) - a, left = position_of(in_edge.x) - a, right = position_of(in_edge.w) - a;
    vec3 across = cross(along, eye.xyz - eye.w * ((a - middle) - middle_rest));
    bool left_front = dot(left, across) <= 0.0, right_front = dot(right, across) >= 0.0;
    bool folds = left_front != right_front;
#ifdef BACKS_HIDDEN
    if (!left_front && !right_front) return NONE;
#endif
#ifndef CREASES
    if (!folds) return NONE;
#endif
    vec3 n = cross(along, left);
    concave = int(dot(n, right) > CERTAIN * length(n) * length(right));
#ifdef BACKS_HIDDEN
    if (folds) concave = 0;  // the nearer of its faces is a back face, which is not drawn: it bounds what is seen or is hidden
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
    return NONE;
}

void main() {
    edge = in_edge;
    kind = kind_of();
    if (only >= 0 && kind != only) kind = NONE;
}
