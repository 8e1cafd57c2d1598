// The part of a pixel outside the segment that the half-plane inside it covers: a half on the segment itself, none where the
// pixel's square no longer touches it.
flat in vec4 segment;
out vec4 fragment;

void main() {
    vec2 along = segment.zw - segment.xy;
    vec2 from_start = gl_FragCoord.xy - segment.xy;
    float t = clamp(dot(from_start, along) / max(dot(along, along), 1e-12), 0.0, 1.0);
    vec2 away = from_start - t * along;
    float distance = length(away);
    // |n.x| + |n.y|: how wide a unit square is along the unit direction n; at the segment itself any n will do
    float width = distance > 1e-6 ? (abs(away.x) + abs(away.y)) / distance : 1.0;
    fragment = vec4(vec3(0.0), clamp(0.5 - distance / width, 0.0, 1.0));
}
