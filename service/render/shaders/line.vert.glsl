// Corners of strokes: x and y in image pixels, and depth, 1 at the eye (`kernels/strokes.py`).
uniform vec2 origin;  // top left pixel of the tile
uniform vec2 pixel;   // size of a pixel in normalised device coordinates
uniform vec2 range;   // from depth to the clip coordinate: scale, shift
in vec3 in_corner;

void main() {
    gl_Position = vec4((in_corner.xy - origin) * pixel - 1.0, in_corner.z * range.x + range.y, 1.0);
}
