// A surface in object space. The definitions NORMAL, UV and COLOR name the attributes there are.
//! include srgb.part.glsl
//! include placed.part.glsl
in vec3 in_position;
#ifdef SHOW_CHARCOAL
uniform vec4 eye;
out vec3 to_eye;
#endif
#if defined(SHOW_FACES) || defined(SHOW_DEPTH)
out vec3 place;
#endif
#ifdef NORMAL
in vec3 in_normal;
out vec3 normal;
#endif
#ifdef UV
in vec2 in_uv;
out vec2 uv;
#endif
#ifdef COLOR
in vec4 in_color;
out vec3 color;
#endif

void main() {
    gl_Position = placed(in_position);
#ifdef SHOW_CHARCOAL
    to_eye = normalize(eye.xyz - eye.w * in_position);
#endif
#if defined(SHOW_FACES) || defined(SHOW_DEPTH)
    place = in_position;
#endif
#ifdef NORMAL
    normal = in_normal;
#endif
#ifdef UV
    uv = in_uv;
#endif
#ifdef COLOR
    color = linear_from_srgb(in_color.rgb);
#endif
}
