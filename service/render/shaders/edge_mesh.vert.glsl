// The vertices of edges, in object space and in clip space.
//! include placed.part.glsl
in vec3 in_position;
out vec3 position;
flat out int vertex;

void main() {
    position = in_position;
    vertex = gl_VertexID;
    gl_Position = placed(in_position);
}
