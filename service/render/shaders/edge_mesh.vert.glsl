// The vertices of edges, in object space: few of them are ever asked where they are on the screen.
in vec3 in_position;
out vec3 position;
#ifdef BORDERS
flat out int vertex;
#endif

void main() {
    position = in_position;
#ifdef BORDERS
    vertex = gl_VertexID;
#endif
}
