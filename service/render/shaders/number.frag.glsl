// 1 + the number of the face.
out int fragment;

void main() {
    fragment = gl_PrimitiveID + 1;
}
