// Colour of a surface as sRGB bytes, opaque. Definitions: NORMAL_MAP (otherwise NORMAL), COLOR_MAP and COLOR (their product;
// neither: base_color), TWO_SIDED, NORMAL_MATRIX (the surface is placed in a scene), and one of SHOW_LAMBERT, SHOW_NORMAL, SHOW_FLAT,
// SHOW_CHARCOAL (the grey of Image Precision Silhouette Edges, section 4).
//! include srgb.part.glsl
uniform vec3 base_color;  // linear
uniform vec3 base_root;   // base_color to the power of 1 / 2.4
uniform vec3 light;       // unit, towards the light, along the axes that normals have in the end
uniform float ambient;
#ifdef NORMAL_MATRIX
uniform mat3 normal_matrix;
#endif
#ifdef SHOW_CHARCOAL
in vec3 to_eye;
#endif
#ifdef NORMAL
in vec3 normal;
#endif
#ifdef UV
in vec2 uv;
#endif
#ifdef COLOR
in vec3 color;
#endif
#ifdef NORMAL_MAP
uniform sampler2D normal_map;
#endif
#ifdef COLOR_MAP
uniform sampler2D color_map;
#endif
out vec4 fragment;

vec3 surface_normal() {
#ifdef NORMAL_MAP
    vec3 n = texture(normal_map, uv).rgb * 2.0 - 1.0;
#else
    vec3 n = normal;
#endif
#ifdef NORMAL_MATRIX
    n = normal_matrix * n;
#endif
#ifdef TWO_SIDED
    n = gl_FrontFacing ? n : -n;
#endif
    return n * inversesqrt(max(dot(n, n), 1e-20));
}

vec3 surface_color() {
    vec3 c = vec3(1.0);
#ifdef COLOR_MAP
    c *= texture(color_map, uv).rgb;
#endif
#ifdef COLOR
    c *= color;
#endif
    return c;
}

void main() {
#if defined(SHOW_NORMAL)
    fragment = vec4(surface_normal() * 0.5 + 0.5, 1.0);
#elif defined(SHOW_CHARCOAL)
    fragment = vec4(vec3((1.0 + dot(normalize(to_eye), surface_normal())) / 3.0), 1.0);
#elif defined(SHOW_FLAT)
    fragment = vec4(srgb_from_linear(base_color), 1.0);
#else
    float lit = mix(max(dot(surface_normal(), light), 0.0), 1.0, ambient);
#if defined(COLOR_MAP) || defined(COLOR)
    fragment = vec4(srgb_from_linear(surface_color() * lit), 1.0);
#else
    // srgb_from_linear(base_color * lit), with the power of the product as the product of powers: one instead of three
    vec3 c = base_color * lit;
    vec3 high = 1.055 * base_root * pow(lit, 1.0 / 2.4) - 0.055;
    fragment = vec4(mix(12.92 * c, high, step(0.0031308, c)), 1.0);
#endif
#endif
}
