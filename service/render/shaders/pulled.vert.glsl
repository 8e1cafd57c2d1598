// Faces pulled towards the eye in depth alone; where they are in the image stays (Image Precision Silhouette Edges, section 3.2).
//! include placed.part.glsl
uniform vec2 range;   // from depth to the clip coordinate: scale, shift
uniform vec3 pull;    // depth d at w becomes d (1 + x) w / (w - z) + y
in vec3 in_position;

void main() {
    vec4 p = placed(in_position);
    float depth = (p.z - range.y * p.w) / range.x;
    depth = depth * (1.0 + pull.x) * p.w / max(p.w - pull.z, 0.05 * p.w) + pull.y * p.w;
    p.z = depth * range.x + range.y * p.w;
    gl_Position = p;
}
