// Colour of a surface as sRGB bytes, opaque. Definitions: NORMAL_MAP (otherwise NORMAL), COLOR_MAP and COLOR (their product;
// neither: base_color), TWO_SIDED, NORMAL_MATRIX (the surface is placed in a scene), and one of SHOW_LAMBERT, SHOW_NORMAL, SHOW_PLAIN,
// SHOW_CHARCOAL (the grey of Image Precision Silhouette Edges, section 4), SHOW_GOOCH, SHOW_FACES, SHOW_DEPTH, SHOW_MATCAP.
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
#if defined(SHOW_FACES) || defined(SHOW_DEPTH)
in vec3 place;  // normalised units: the mesh is within 1 of the origin
#endif
#ifdef SHOW_FACES
uniform float turn;  // -1 where the placement mirrors, else 1
#endif
#ifdef SHOW_DEPTH
uniform vec4 nearness;  // of a place, from 1 to -1 over all that is drawn
#endif
#ifdef SHOW_MATCAP
uniform mat3 camera_axes;  // takes directions, along the axes that normals have in the end, to right, up and backward
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

vec3 base() {
#if defined(COLOR_MAP) || defined(COLOR)
    return surface_color();
#else
    return base_color;
#endif
}

#ifdef SHOW_FACES
// on the side that is seen: rows run downwards in the target
vec3 face_normal() {
    vec3 n = turn * cross(dFdy(place), dFdx(place));
    n *= inversesqrt(max(dot(n, n), 1e-30));
#ifdef NORMAL_MATRIX
    n = normal_matrix * n;
#endif
    return n * inversesqrt(max(dot(n, n), 1e-30));
}
#endif

#ifdef SHOW_MATCAP
vec3 clay(vec3 n, vec3 c) {
    float key = max(dot(n, vec3(-0.408, 0.577, 0.707)), 0.0);
    float gloss = pow(max(dot(n, vec3(-0.221, 0.312, 0.924)), 0.0), 40.0);
    float rim = pow(1.0 - clamp(n.z, 0.0, 1.0), 3.0);
    return c * (0.12 + 0.78 * key) + vec3(0.25 * gloss) + 0.22 * rim * mix(c, vec3(1.0), 0.5);
}
#endif

void main() {
#if defined(SHOW_NORMAL)
    fragment = vec4(surface_normal() * 0.5 + 0.5, 1.0);
#elif defined(SHOW_CHARCOAL)
#ifdef NORMAL_MATRIX
    vec3 v = normalize(normal_matrix * to_eye);  // lines are drawn of no mesh that is stretched: this turns, and mirrors
#else
    vec3 v = normalize(to_eye);
#endif
    fragment = vec4(vec3((1.0 + dot(v, surface_normal())) / 3.0), 1.0);
#elif defined(SHOW_GOOCH)
    float warmth = 0.5 + 0.5 * dot(surface_normal(), light);
    vec3 tone = srgb_from_linear(base());  // Gooch's blue and yellow are of displayed colours
    fragment = vec4(mix(vec3(0.0, 0.0, 0.4) + 0.2 * tone, vec3(0.4, 0.4, 0.0) + 0.6 * tone, warmth), 1.0);
#elif defined(SHOW_FACES)
    fragment = vec4(srgb_from_linear(base() * mix(max(dot(face_normal(), light), 0.0), 1.0, ambient)), 1.0);
#elif defined(SHOW_DEPTH)
    fragment = vec4(vec3(clamp(0.5 + 0.45 * (dot(nearness.xyz, place) + nearness.w), 0.0, 1.0)), 1.0);
#elif defined(SHOW_MATCAP)
    fragment = vec4(srgb_from_linear(min(clay(camera_axes * surface_normal(), base()), vec3(1.0))), 1.0);
#elif defined(SHOW_PLAIN)
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
