// Triangles of the silhouette's loops.
//! include placed.part.glsl
in vec3 in_position;

void main() {
    gl_Position = placed(in_position);
}
