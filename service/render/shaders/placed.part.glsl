// Where a position of the object is in clip space; `middle` and `middle_rest` are taken off first (`FrameState.placement`).
uniform mat4 clip_from_object;
uniform vec3 middle;
uniform vec3 middle_rest;

vec4 placed(vec3 position) {
    return clip_from_object * vec4((position - middle) - middle_rest, 1.0);
}
