// The part of a pixel that is inside a segment's half-plane: a half on the segment itself, none (or, for a pixel whose centre is inside,
// all of it) where the pixel's square no longer touches it.
flat in vec4 segment;
out vec4 fragment;

void main() {
    vec2 along = segment.zw - segment.xy;
    vec2 from_start = gl_FragCoord.xy - segment.xy;
    float t = clamp(dot(from_start, along) / max(dot(along, along), 1e-12), 0.0, 1.0);
    vec2 away = from_start - t * along;
    float distance = length(away);
    // unit direction to the pixel, its larger part first; at the segment itself any will do
    vec2 n = distance > 1e-6 ? abs(away) / distance : vec2(1.0, 0.0);
    if (n.x < n.y) n = n.yx;
    // what a straight edge so far from the middle of a unit square leaves on its other side: a trapezium, or a triangle
    float half_width = 0.5 * (n.x + n.y), left = max(half_width - distance, 0.0);
    float beyond = distance < 0.5 * (n.x - n.y) ? 0.5 - distance / n.x : 0.5 * left * left / max(n.x * n.y, 1e-6);
#ifdef INSIDE
    // to the other side of an edge that has a layer behind it the shape goes on, and so it may past the end of one
    vec2 forward = along / max(length(along), 1e-6);
    float past = dot(from_start, forward);
    if (forward.x * from_start.y - forward.y * from_start.x > 0.0 || past < 0.0 || past > length(along)) discard;
    beyond = 1.0 - beyond;
#endif
    fragment = vec4(vec3(0.0), beyond);
}
