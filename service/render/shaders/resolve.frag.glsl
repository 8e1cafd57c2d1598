// The mean of a pixel's samples in linear light, weighted by their alpha, as straight sRGB. MULTISAMPLED: of a multisampled
// texture of SAMPLES samples; otherwise of a box of 2 HALF_SCALE x 2 HALF_SCALE texels (one texel for 0), four at a time by bilinear lookups
// (texels that were not drawn are zero in every channel, so that the lookup's mean is premultiplied).
//! include srgb.part.glsl
#ifdef MULTISAMPLED
uniform sampler2DMS samples;
#else
uniform sampler2D samples;
uniform vec2 texel;
#endif
out vec4 fragment;

vec4 mean_of_samples() {
    vec4 total = vec4(0.0);
#ifdef MULTISAMPLED
    ivec2 at = ivec2(gl_FragCoord.xy);
    for (int i = 0; i < SAMPLES; i++) {
        total += texelFetch(samples, at, i);
    }
    return total / float(SAMPLES);
#elif HALF_SCALE == 0
    return texelFetch(samples, ivec2(gl_FragCoord.xy), 0);
#else
    vec2 corner = floor(gl_FragCoord.xy) * float(2 * HALF_SCALE) + 1.0;
    for (int y = 0; y < HALF_SCALE; y++) {
        for (int x = 0; x < HALF_SCALE; x++) {
            total += texture(samples, (corner + 2.0 * vec2(x, y)) * texel);
        }
    }
    return total / float(HALF_SCALE * HALF_SCALE);
#endif
}

void main() {
    vec4 mean = mean_of_samples();
    fragment = mean.a > 0.0 ? vec4(srgb_from_linear(mean.rgb / mean.a), mean.a) : vec4(0.0);
}
