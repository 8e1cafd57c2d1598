// One colour, premultiplied where it is blended.
uniform vec4 color;
out vec4 fragment;

void main() {
    fragment = color;
}
