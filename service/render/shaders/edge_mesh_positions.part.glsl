// Positions of vertices by their number, in rows of 2048 (`edge_mesh.COLUMNS`).
uniform sampler2D positions;

vec3 position_of(int vertex) {
    return texelFetch(positions, ivec2(vertex & 2047, vertex >> 11), 0).xyz;
}
