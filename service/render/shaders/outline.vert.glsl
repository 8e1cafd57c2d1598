// Silhouette segments in image pixels, each as a rectangle that reaches one pixel beyond it on every side.
uniform vec2 origin;  // top left pixel of the tile
uniform vec2 pixel;   // size of a pixel in normalised device coordinates
in vec4 in_segment;   // x, y of its start, x, y of its end
flat out vec4 segment;

const float REACH = 1.0;

void main() {
    vec2 p = in_segment.xy - origin, q = in_segment.zw - origin;
    segment = vec4(p, q);
    vec2 along = q - p;
    along = dot(along, along) > 1e-12 ? normalize(along) : vec2(1.0, 0.0);
    float side = (gl_VertexID & 1) == 0 ? REACH : -REACH;
    vec2 corner = (gl_VertexID >= 2 ? q + REACH * along : p - REACH * along) + side * vec2(-along.y, along.x);
    gl_Position = vec4(corner * pixel - 1.0, 0.0, 1.0);
}
