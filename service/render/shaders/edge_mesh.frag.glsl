// A line with round ends, where the nearest point of its edge is not hidden.
//
// Of the four pixel centres about a point of an edge at least one is on either side of the edge. So an edge that bounds what is seen, or
// that is convex, is hidden only when the surface is nearer than the edge at all four of them, and then something else hides it.
// MULTISAMPLED: depth has SAMPLES samples.
uniform vec4 colors[4];  // of each kind: as the target has them, and opacity
uniform vec2 size;
uniform float farther;   // sign by which depth grows with the distance
#ifdef MULTISAMPLED
uniform sampler2DMS depth;
#else
uniform sampler2D depth;
#endif
flat in vec4 ends;
flat in vec4 shape;
flat in vec2 style;
out vec4 fragment;

float farthest_at(ivec2 at) {
#ifdef MULTISAMPLED
    float far = -1.0;
    for (int i = 0; i < SAMPLES; i++) far = max(far, farther * texelFetch(depth, at, i).r);
    return far;
#else
    return farther * texelFetch(depth, at, 0).r;
#endif
}

void main() {
    vec2 along = ends.zw - ends.xy;
    float t = clamp(dot(gl_FragCoord.xy - ends.xy, along) / max(dot(along, along), 1e-12), 0.0, 1.0);
    vec2 nearest = ends.xy + t * along;
    vec2 away = gl_FragCoord.xy - nearest;
    float half_width = mix(shape.x, shape.y, t);
    if ((t <= 0.0 || t >= 1.0) && dot(away, away) > half_width * half_width) discard;
    float hidden_before = mix(shape.z, shape.w, t) - style.x;
    ivec2 last = ivec2(size) - 1;
    ivec2 low = clamp(ivec2(floor(nearest - 0.5)), ivec2(0), last), high = min(low + 1, last);
    if (farthest_at(low) < hidden_before && farthest_at(high) < hidden_before
        && farthest_at(ivec2(low.x, high.y)) < hidden_before && farthest_at(ivec2(high.x, low.y)) < hidden_before) discard;
    fragment = colors[int(style.y)];
}
